"""The shape of the house: floors, circles of imports, one home per default, the public names."""

import ast
import importlib
import re
import sys
from collections import Counter, defaultdict
from functools import cache

import pytest
from repository import ROOT

import lidar_core

sys.path.insert(0, str(ROOT / "tests"))
house = importlib.import_module("house_numbers")

CORE = ROOT / "rust/lidar_core/src"
SIMULATOR = ROOT / "rust/lidar_sim/src"
PACKAGE = ROOT / "python/lidar_core"
BINDING = ROOT / "rust/lidar_core_py/src"
READERS = {CORE: "rust", SIMULATOR: "rust", BINDING: "rust", PACKAGE: "python"}
MOST_TESTS_IN_A_FOLDER = 16
DEFINED_TWICE = {"Measurement", "Motion", "NoiseForm", "Sensor", "State"}
"""Rust type names that two places define; this set only gets smaller."""

RUST_FLOORS = (
    {"error"},
    {"util"},
    {"geometry", "estimation", "probability"},
    {"tracking"},
    {"circles", "flying", "fusion"},
    {"state_layouts"},
)
PYTHON_FLOORS = (
    {"errors", "plugins", "files", "extras", "config", "arrays", "sensors", "messages"},
    {"parameters", "use_cases", "geometry", "estimation", "objects"},
    {"io"},
    {"run_folder", "util"},
    {"sim"},
    {"evaluation"},
    {"circles", "flying", "fusion"},
    {"scan_processing", "viz"},
    {"batch", "live"},
    {"reproduce"},
    {"runs"},
    {"cli"},
    {"__main__"},
)
"""Names of the top, lowest floor first: code imports its own folder and what lies on lower floors.

Names of the lowest floor may also import one another.
"""
UPWARD = {("evaluation", "flying")}
"""Imports that still run up; this set only gets smaller."""


@cache
def imports_of(root):
    return (house.rust_imports if READERS[root] == "rust" else house.python_imports)(root)


def heads_of(root):
    """Modules that are folders."""
    modules = (house.rust_modules if READERS[root] == "rust" else house.python_modules)(root)
    return {module for module, path in modules.items() if path.name in {"mod.rs", "__init__.py"}}


ROOTS = pytest.mark.parametrize("root", READERS, ids=lambda root: root.parent.name)


def test_rust_type_names_are_defined_once():
    assert set(house.rust_types_defined_twice([CORE])) == DEFINED_TWICE


@ROOTS
def test_no_files_import_one_another_in_a_circle(root):
    assert house.circles_of(imports_of(root)) == []


@ROOTS
def test_folders_import_one_another_in_one_direction(root):
    assert house.circles_across(imports_of(root), heads_of(root)) == []


def test_circles_of_folders_are_seen_at_every_depth():
    """A folder and one in it may know each other, also where both lie in a circle; others not."""
    one, two, part = ("top", "one"), ("top", "two"), ("top", "one", "part")
    below, back = {(*part, "x"): {(*one, "x")}}, {(*one, "y"): {(*part, "x")}}
    nested = {("top", "x"): {(*one, "x")}, (*one, "x"): {("top", "y")}, **below, **back}
    heads = {("top",), one, two, part}
    assert house.circles_across(nested, heads) == []
    beside = {**nested, (*two, "x"): {(*part, "x")}, (*part, "y"): {(*two, "y")}}
    assert house.circles_across(beside, heads) != []


def upward(imports, floors):
    """Pairs of names of the top of which the first imports the second and does not lie above it."""
    floor_of = {name: number for number, floor in enumerate(floors) for name in floor}
    between = defaultdict(set)
    for module, others in imports.items():
        between[module[:1]] |= {other[:1] for other in others if other[:1] != module[:1]}
    named = {name for (name,) in (set(between) | set().union(*between.values())) - {()}}
    assert named <= set(floor_of), "a new name of the top: put it on a floor"
    return {
        (one, other)
        for (one,), others in between.items()
        if (one,) != ()
        for (other,) in others
        if floor_of[one] < floor_of[other] or (floor_of[one] == floor_of[other] > 0)
    }


def without_roots(imports):
    """The imports of all modules but the root's, which offers what lies below it."""
    return {module: others for module, others in imports.items() if module}


def test_the_core_imports_only_lower_floors():
    found = upward(without_roots(imports_of(CORE)), RUST_FLOORS)
    # Tools below the arithmetic use one another.
    assert {pair for pair in found if not set(pair) <= RUST_FLOORS[1]} == set()


def test_the_package_imports_only_lower_floors():
    found = upward(without_roots(imports_of(PACKAGE)), PYTHON_FLOORS)
    assert {pair for pair in found if not set(pair) <= PYTHON_FLOORS[1]} <= UPWARD


def test_only_the_program_imports_the_command_line():
    imports = imports_of(PACKAGE)
    assert imports["cli", "detect"]  # it reads imports at all
    assert [
        module
        for module, others in imports.items()
        if module[0:1] != ("cli",) and any(other[0] == "cli" for other in others)
    ] == [("__main__",)]


def test_floors_see_what_runs_up():
    floors = ({"low"}, {"one", "two"}, {"high"})
    imports = {("low",): {("high", "part")}, ("one",): {("two",), ("low",)}, ("high",): {("low",)}}
    assert upward(imports, floors) == {("low", "high"), ("one", "two")}


def test_a_motion_model_is_named_in_its_own_file_and_in_the_list_of_models():
    roots = [CORE, BINDING]
    named = house.files_naming(r'\bCtra\b|"ctra"', roots, PACKAGE)
    assert sorted(named) == ["heading.rs", "model_list.rs"]


# Files that cargo compiles

MANIFESTS = ("rust/*/Cargo.toml", "benches/Cargo.toml", "fuzz/Cargo.toml")
RUST_FOLDERS = ("rust", "benches", "tests/rust", "fuzz")


def test_every_rust_file_is_a_module_or_a_target():
    manifests = [path for pattern in MANIFESTS for path in ROOT.glob(pattern)]
    assert len(manifests) == 5
    for folder in RUST_FOLDERS:
        found = house.rust_files_of_no_module(ROOT / folder, manifests)
        assert [path for path in found if "target" not in path.parts] == []


@pytest.mark.parametrize(
    ("declared", "missed"),
    [
        ("mod one;\npub(crate) mod two;", []),
        ("mod one;\n// mod two;", ["two/mod.rs", "two/three.rs"]),
        ("mod one { }\nmod two;", ["one.rs", "one/four.rs"]),
        ('#[path = "one.rs"]\nmod other;\nmod two;', ["one/four.rs"]),
    ],
)
def test_a_rust_file_that_nothing_declares_is_seen(tmp_path, declared, missed):
    manifest, src = tmp_path / "Cargo.toml", tmp_path / "src"
    texts = {"lib.rs": declared, "one.rs": "mod four;", "two/mod.rs": "pub mod three;"}
    for name, text in (texts | {"one/four.rs": "", "two/three.rs": ""}).items():
        (src / name).parent.mkdir(parents=True, exist_ok=True)
        (src / name).write_text(text, encoding="utf-8")
    manifest.write_text("[package]\n", encoding="utf-8")
    found = house.rust_files_of_no_module(src, [manifest])
    assert {path.relative_to(src).as_posix() for path in found} == set(missed)


# One home per default

DEFAULT = re.compile(r"impl Default for (\w+)")
NUMBER = re.compile(r":\s*(?:Some\()?\[?-?\d")


def rust_files():
    folders = ("rust/lidar_core/src", "rust/lidar_sim/src", "benches", "tests/rust")
    return [path for folder in folders for path in (ROOT / folder).rglob("*.rs")]


def product_code(path):
    """Its text, without the tests of a crate's own modules, which need values of their own."""
    text = path.read_text(encoding="utf-8")
    return house.without_tests(text) if "src" in path.parts else text


def copies_in(text, names):
    """Literals of parameter structs that state three numbers or more and take nothing over."""
    text = re.sub(r"//.*", "", text)
    for found in re.finditer(rf"(\w+\s+|-> )?\b({'|'.join(names)}) \{{", text):
        if (found[1] or "").strip() in {"struct", "impl", "for", "enum", "->"}:
            continue
        depth, end = 1, found.end()
        while depth and end < len(text):
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        body = text[found.end() : end]
        if ".." not in body and len(NUMBER.findall(body)) >= 3:
            yield found[2]


def test_configurations_are_stated_once_in_rust():
    texts = [product_code(path) for path in CORE.rglob("*.rs")]
    names = {name for text in texts for name in DEFAULT.findall(text)}
    assert {"FlyingParameters", "PipelineParameters", "FusionParameters"} <= names
    copies = {
        path.relative_to(ROOT).as_posix(): found
        for path in rust_files()
        if (found := list(copies_in(product_code(path), names)))
    }
    assert copies == {}, "begin with Default or paper() and state what differs"


def defaults_away_from_home(texts):
    """Types whose default does not stand in the file that declares them."""
    return [
        name
        for text in texts
        for name in DEFAULT.findall(text)
        if not re.search(rf"\b(?:struct|enum) {name}\b", text)
    ]


def test_a_default_stands_beside_the_struct_that_it_fills():
    """So a new parameter and its value are one place in Rust."""
    assert defaults_away_from_home(product_code(path) for path in CORE.rglob("*.rs")) == []
    apart = ["pub struct Map { size: f64 }", "impl Default for Map {}"]
    assert defaults_away_from_home(apart) == ["Map"]
    assert defaults_away_from_home(["\n".join(apart)]) == []


def positional_defaults(text):
    """Lines of calls of pydantic's Field whose default has no name."""
    if "pydantic" not in text:
        return []
    tree = ast.parse(text)
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    if "pydantic" not in modules:
        return []
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    return [node.lineno for node in calls if getattr(node.func, "id", "") == "Field"]


def test_type_checkers_see_which_parameters_have_defaults():
    """Without pydantic's plugin they ask for every parameter whose default is positional."""
    found = {
        f"{path.relative_to(ROOT)}: {line}"
        for folder in ("python", "training")
        for path in (ROOT / folder).rglob("*.py")
        for line in positional_defaults(path.read_text(encoding="utf-8"))
    }
    assert not found


def test_a_default_without_a_name_is_seen():
    made = "from pydantic import Field\nx: int = Field({}1, gt=0)\n"
    assert positional_defaults(made.format("")) == [2]
    assert positional_defaults(made.format("default=")) == []
    assert positional_defaults("from a import Field\nx = Field(1)\n") == []


def test_a_copied_configuration_is_seen():
    full = "let x = Map { size: 0.25, gain: 1.0, low: [-1.0; 3] };"
    assert list(copies_in(full, {"Map"})) == ["Map"]
    assert list(copies_in(full.replace(" }", ", ..Map::default() }"), {"Map"})) == []
    assert list(copies_in("impl Map { fn a() { f(a: 1, b: 2, c: 3) } }", {"Map"})) == []


def test_folders_of_tests_stay_small_and_have_the_names_of_the_package():
    files = list((ROOT / "tests/python").rglob("test_*.py"))
    folders = Counter(path.parent.relative_to(ROOT / "tests/python").as_posix() for path in files)
    assert {name: count for name, count in folders.items() if count > MOST_TESTS_IN_A_FOLDER} == {}
    own = {"base", "house", "io/hostile"}
    places = (PACKAGE, CORE)
    known = own | {name for name in folders for place in places if (place / name).is_dir()}
    assert sorted(folders.keys() - known) == []
    assert len({path.name for path in files}) == len(files), "pytest needs different names"


# Length

LONGER = "Longer than other"
"""Begins the reason of a file above 400 lines, or of a function above 40."""


def long_files_without_a_reason(texts, most=400):
    """Names of texts with more lines than `most` and no reason among the first lines."""
    for name, text in texts:
        first = "\n".join(text.splitlines()[:20])
        if text.count("\n") > most and LONGER not in first:
            yield name


def test_what_is_longer_than_others_says_why():
    crates = [CORE, SIMULATOR, BINDING]
    assert house.long_rust_functions(crates, unless=f"// {LONGER} functions: ") == []
    paths = [path for root in crates for path in house.rust_modules(root).values()]
    paths = [path for path in paths if not path.stem.endswith("tests")]
    paths += PACKAGE.rglob("*.py")
    texts = ((str(path.relative_to(ROOT)), product_code(path)) for path in paths)
    assert list(long_files_without_a_reason(texts)) == []


def test_a_long_file_or_function_without_a_reason_is_seen(tmp_path):
    texts = [("short", "\n" * 9), ("long", "\n" * 10), ("told", f"//! {LONGER}" + "\n" * 10)]
    assert list(long_files_without_a_reason(texts, most=9)) == ["long"]
    body = "    let x = 1;\n" * 40
    (tmp_path / "lib.rs").write_text(
        f"fn one() {{\n{body}}}\n\nfn two() {{\n    // {LONGER}\n{body}}}\n", encoding="utf-8"
    )
    assert house.long_rust_functions([tmp_path], unless=LONGER) == ["lib.rs:one"]


# Doc comments

FIRST_IS_A_HEADING = re.compile(r"^(?![ \t]*//[/!]).*\n[ \t]*//[/!] (# .*)$", re.M)
"""The first line of a doc comment in Rust, if it is a heading such as "# Errors"."""


def test_doc_comments_say_what_it_is_before_they_list_errors():
    paths = [path for folder in RUST_FOLDERS for path in (ROOT / folder).rglob("*.rs")]
    found = {
        path.relative_to(ROOT).as_posix(): headings
        for path in paths
        if "target" not in path.parts
        and (headings := FIRST_IS_A_HEADING.findall("\n" + path.read_text(encoding="utf-8")))
    }
    assert found == {}, "begin with a sentence that says what the function does"


def test_a_doc_comment_without_a_summary_is_seen():
    body = "/// # Errors\n/// [`Error`].\npub fn new() {}\n"
    assert FIRST_IS_A_HEADING.findall("impl A {\n    " + body) == ["# Errors"]
    assert FIRST_IS_A_HEADING.findall("\n" + body) == ["# Errors"]
    assert FIRST_IS_A_HEADING.findall("\n/// Make it.\n///\n" + body) == []


# Public names


PUBLIC_MODULES = ["lidar_core", *(f"lidar_core.{name}" for name in lidar_core._LAZY)]


def public_names():
    """Dotted names of everything that a public module exports."""
    return sorted(
        f"{module}.{name}"
        for module in PUBLIC_MODULES
        for name in importlib.import_module(module).__all__
    )


@pytest.mark.parametrize("module", PUBLIC_MODULES)
def test_dir_shows_the_public_names_alone(module):
    found = importlib.import_module(module)
    assert dir(found) == sorted(found.__all__)
    assert all(hasattr(found, name) for name in dir(found))


def plain_modules():
    """Modules at the package's top, and those that README, guide or examples import from."""
    pages = [ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.py")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    named = set(re.findall(r"^\s*from (lidar_core(?:\.\w+)+) import", text, re.M))
    top = {f"lidar_core.{path.stem}" for path in PACKAGE.glob("*.py") if path.stem[0] != "_"}
    return sorted(named | top)


@pytest.mark.parametrize("module", plain_modules())
def test_modules_that_users_import_show_what_they_define_alone(module):
    found = importlib.import_module(module)
    assert dir(found) == sorted(found.__all__)
    assert [name for name in found.__all__ if not hasattr(found, name)] == []


def test_the_public_names_are_the_listed_ones():
    listed = (ROOT / "tests/golden/public_names.txt").read_text(encoding="utf-8").split()
    found = public_names()
    text = "if this is intended: add or remove it in public_names.txt, a line in the changelog"
    assert sorted(set(found) - set(listed)) == [], text
    assert sorted(set(listed) - set(found)) == [], text
    assert listed == sorted(listed)
