"""Memory whose size comes from input is asked for first, or its size has a limit.

Most allocations of Rust cannot fail: without memory they end the process. So whoever adds one whose
size is no constant has to say in `tests/rust/allocations.toml` what bounds it.
"""

import re
import tomllib

from repository import ROOT

SIZED = re.compile(
    r"""\b(?:with_capacity|resize|resize_with|reserve|reserve_exact)\(\s*(?P<size>[^,;]+?)\s*[,)]
    |\bvec!\[[^;\]]*;\s*(?P<repeat>[^\]]+)\]""",
    re.VERBOSE,
)
CONSTANT = re.compile(r"[A-Z0-9_\s+*/<(-]+(?: as usize)?")
"""Literals and constants, no variables."""


def sized(text):
    """Sizes of the allocations in Rust code that are no constants, up to their first bracket.

    Comments and tests are left out.
    """
    code = re.sub(r"//.*", "", text.split("#[cfg(test)]\nmod")[0])
    code = re.sub(r"\bfn (?:with_capacity|resize|reserve)\b", "", code)
    sizes = [found["size"] or found["repeat"] for found in SIZED.finditer(code)]
    return [size.rstrip("()") for size in sizes if not CONSTANT.fullmatch(size)]


def counted():
    """How many such allocations a file has."""
    found = {}
    for path in sorted(ROOT.glob("rust/*/src/**/*.rs")):
        if path.name != "tests.rs" and (sizes := sized(path.read_text("utf-8"))):
            found[path.relative_to(ROOT / "rust").as_posix().replace("/src/", "/")] = len(sizes)
    return found


def test_every_allocation_by_size_says_what_bounds_it():
    told = tomllib.loads((ROOT / "tests/rust/allocations.toml").read_text("utf-8"))
    files = [file for bound in told.values() for file in bound if file != "why"]
    assert len(files) == len(set(files))
    counts = {file: bound[file] for bound in told.values() for file in bound if file != "why"}
    assert all(bound["why"] for bound in told.values())
    assert counts == counted()


def test_those_that_ask_do_ask():
    told = tomllib.loads((ROOT / "tests/rust/allocations.toml").read_text("utf-8"))
    for file in told["asks_itself"].keys() - {"why"}:
        crate, _, rest = file.partition("/")
        text = (ROOT / "rust" / crate / "src" / rest).read_text("utf-8")
        assert re.search(r"check_memory\(|check_scan_memory\(|vec_with_capacity\(", text), file


def test_sizes_that_come_from_input_are_seen():
    assert sized("let a = vec![0; n]; b.resize(points.len(), 0.0); c.reserve(k);") == [
        *("n", "points.len", "k")
    ]
    assert sized("Vec::with_capacity(\n    2 * rows,\n)") == ["2 * rows"]
    constants = "vec![0; CELLS * BINS]; a.resize(1 << (SIZE_BITS - 6), 0); Vec::with_capacity(64)"
    assert sized(constants) == []
    assert sized("// vec![0; n]\n#[cfg(test)]\nmod tests { fn a() { vec![0; n] } }") == []
