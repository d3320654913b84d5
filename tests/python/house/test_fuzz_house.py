"""Every public callable has a fuzz entry; the fuzz house finds what is planted."""

import re
import sys
import tomllib

import pytest
from repository import ROOT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and fork as on Linux")
FUZZ = ROOT / "tests" / "rust" / "fuzz"
FUNCTION = re.compile(r"^ *pub (?:const )?fn (\w+)", re.MULTILINE)


def is_public(parts, source):
    """Whether users of the crate reach a file: by `pub mod` all the way, or by `pub use`."""
    heads = [
        source / "lib.rs",
        *(source.joinpath(*parts[:n]) / "mod.rs" for n in range(1, len(parts))),
    ]
    text = [head.read_text() for head in heads]
    named = rf"^pub use (?:\w+::)*{parts[-1]}::"
    return all(
        re.search(rf"^pub mod {part};", one, re.MULTILINE)
        for part, one in zip(parts, text, strict=True)
    ) or any(re.search(named, one, re.MULTILINE) for one in text)


def public_functions():
    """Functions that users of the crates can call, by file."""
    found = {}
    for crate in ("lidar_core", "lidar_sim"):
        source = ROOT / "rust" / crate / "src"
        for path in sorted(source.rglob("*.rs")):
            parts = list(path.relative_to(source).with_suffix("").parts)
            parts = parts[:-1] if parts[-1] == "mod" else parts
            names = FUNCTION.findall(path.read_text().split("#[cfg(test)]\nmod")[0])
            if names and parts != ["lib"] and is_public(parts, source):
                found[f"{crate}/{path.relative_to(source)}"] = set(names)
    return found


def missing(functions, bodies, through):
    """Functions that no target calls and no other entry names; names of entries without one."""
    called = set(re.findall(r"\b(\w+)(?:::<[^>]*>)?\(", bodies))
    lost = {(file, name) for file, names in functions.items() for name in names - called}
    told = {(file, name) for file, names in through.items() for name in names}
    return lost - told, told - {(f, n) for f, names in functions.items() for n in names}


def test_every_public_rust_function_has_an_entry():
    functions = public_functions()
    bodies = "\n".join(path.read_text() for path in sorted(FUZZ.glob("*.rs")))
    through = tomllib.loads((FUZZ / "manifest.toml").read_text())
    assert sum(map(len, functions.values())) > 200  # it reads functions at all
    known = set(re.findall(r'"(\w+)", \w+::\w+\)', bodies))
    assert {name for name in through if name not in known} == set()
    entries = {}
    for files in through.values():
        for file, names in files.items():
            entries.setdefault(file, set()).update(names)
    lost, stale = missing(functions, bodies, entries)
    assert (lost, stale) == (set(), set())


def test_a_function_without_an_entry_is_told():
    functions = {"a.rs": {"called", "lost", "inside"}}
    lost, stale = missing(functions, "x.called(1)", {"a.rs": ["inside", "gone"]})
    assert (lost, stale) == ({("a.rs", "lost")}, {("a.rs", "gone")})


def test_every_callable_of_the_module_has_an_entry():
    from fuzz_house.core_calls import callables, stub_entries

    assert callables() == set(stub_entries())


def test_some_calls_of_everything(tmp_path, monkeypatch):
    from fuzz_house.core_calls import Caller

    monkeypatch.chdir(tmp_path)  # some calls write files
    caller = Caller(7)
    for name in caller.entries:
        caller.call(name)
    assert sum(caller.accepted.values()) > 10


def test_seeds_of_states_are_of_the_layout_of_now():
    """Bytes of an old layout end at once: nothing behind them would ever be reached."""
    from fuzz_house.rust import CORPUS, LONGEST, USUAL
    from fuzz_house.seeds import MOST_BYTES, owners, prefix, reads

    found = owners()
    told = "stale: `python -m fuzz_house.seeds` writes them again"
    for target, owner in found.items():
        seeds = [path.read_bytes() for path in sorted((CORPUS / target).glob("seed-*"))]
        contents = [one.removeprefix(prefix(target)) for one in seeds]
        if len(owner[0].to_state()) <= MOST_BYTES:  # longer ones are not in git
            assert any(reads(owner, one) for one in contents), f"{target}: {told}"
        limit = LONGEST.get(target, USUAL)
        assert all(len(one) <= limit for one in seeds), f"{target}: a seed is cut to {limit}"
    assert not reads(found["state_tracker"], b"\xff" * 40)
