"""The house: what its papers say about it is true."""

import ast
import importlib
import json
import pkgutil
import re
import runpy
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import pytest
from repository import ROOT

import lidar_core
from lidar_core import _core
from lidar_core.config import Config
from lidar_core.parameters import MODELS, model_named, models_within

PACKAGE = ROOT / "python" / "lidar_core"
PAPERS = [
    *ROOT.glob("*.md"),
    *ROOT.glob("docs/**/*.md"),
    *ROOT.glob("tests/**/*.md"),
    ROOT / "training/README.md",
]
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_IMPORTS = {"pickle", "marshal", "shelve", "dill"}
MOST_PARAMETERS = 450
TARGETS = {"bench", "ci", "clean", "demo", "dev", "docs", "fmt", "help", "lint", "test", "wheel"}


def text_of(path):
    return (ROOT / path).read_text(encoding="utf-8")


def set_up_commands():
    """Lines of the README's section on setting up."""
    section = text_of("README.md").partition("\n## Set-up\n")[2].partition("\n## ")[0]
    (block,) = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    return block.strip().splitlines()


def modules():
    """Names of every Python module of the package."""
    found = pkgutil.walk_packages(lidar_core.__path__, "lidar_core.")
    return [module.name for module in found if module.name != _core.__name__]


def first_party_rust():
    folders = ("rust", "benches", "tests/rust")
    return [path for folder in folders for path in (ROOT / folder).rglob("*.rs")]


# Papers


def test_contributing_names_paths_and_types_that_exist():
    text = text_of("CONTRIBUTING.md")
    named = re.findall(r"`((?:rust|python|tests|docs|benches|fuzz)/[\w./-]+)`", text)
    assert len(named) > 40
    assert [path for path in named if not (ROOT / path).exists()] == []
    types = set(re.findall(r"`([A-Z][a-z]\w*)`", text))
    code = [*PACKAGE.rglob("*.py"), *first_party_rust()]
    words = {word for path in code for word in re.findall(r"\w+", path.read_text("utf-8"))}
    assert len(types) > 8
    assert sorted(types - words) == []


def test_architecture_names_paths_that_exist():
    named = re.findall(r"`([\w.-]+(?:/[\w.-]+)*/?)`", text_of("ARCHITECTURE.md"))
    paths = [name for name in named if "/" in name or name.endswith((".rs", ".py", ".toml"))]
    assert len(paths) > 40
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_architecture_names_every_folder_of_code():
    text = text_of("ARCHITECTURE.md")
    sources = [*ROOT.glob("rust/*/src"), *ROOT.glob("rust/*/src/**/"), *PACKAGE.glob("**/")]
    folders = {path.relative_to(ROOT).as_posix() for path in sources}
    assert [
        path for path in sorted(folders) if "__pycache__" not in path and f"`{path}/" not in text
    ] == []


@pytest.mark.parametrize("paper", PAPERS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_between_papers_lead_somewhere(paper):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", paper.read_text(encoding="utf-8"))
    made_by_the_build = {"parameters.md", "sensors.md"}
    local = [link for link in links if not re.match(r"[a-z]+:", link)]
    broken = [
        link
        for link in local
        if link not in made_by_the_build and not (paper.parent / link).exists()
    ]
    assert broken == []


def test_readme_has_two_set_up_commands_and_ci_runs_them():
    first, second = set_up_commands()
    assert first.endswith("&& .venv/bin/lidar-core demo")
    assert second == "make test"
    ci = text_of(".ci/run")
    assert 'run_tests "$test_command"' in ci
    assert "venv/bin/lidar-core demo" in ci
    make_demo = text_of("Makefile").partition("\ndemo:")[2].partition("\n\n")[0]
    recipe = make_demo.replace("$(PYTHON)", "python3").replace("$(BIN)", "$(VENV)/bin")
    steps = [line.strip() for line in recipe.replace("$(VENV)", ".venv").splitlines()[1:]]
    assert " && ".join(steps) == first


def test_ci_finds_the_test_command_of_the_readme():
    script = text_of(".ci/run")
    expression = re.search(r'^test_command="(\$\(.*?\))"\n', script, re.DOTALL | re.MULTILINE)[1]
    done = subprocess.run(
        ["bash", "-c", f'printf %s "{expression}"'],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert done.stdout == set_up_commands()[1]


def test_the_readmes_example_is_the_one_in_examples():
    (example,) = re.findall(r"```python\n(.*?)```", text_of("README.md"), re.DOTALL)
    assert text_of("examples/quickstart.py").endswith('"""\n\n' + example)
    assert sum(1 for line in example.splitlines() if line.strip()) <= 15


@pytest.mark.parametrize("paper", PAPERS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_python_in_papers_uses_names_that_exist(paper):
    for block in re.findall(r"```python\n(.*?)```", paper.read_text(encoding="utf-8"), re.DOTALL):
        ast.parse(block)
        for dotted in re.findall(r"\blc\.([A-Za-z_.]+)", block):
            held = lidar_core
            for name in dotted.split("."):
                held = getattr(held, name)


def test_the_scenes_of_the_guide_can_be_simulated():
    texts = re.findall(r"```toml\n(.*?)```", text_of("docs/simulation.md"), re.DOTALL)
    assert len(texts) == 4
    for text in texts:
        scene = lidar_core.sim.Scene.load(tomllib.loads(text))
        (scan,) = lidar_core.sim.simulate(scene, seed=0, scans=1)
        assert (scan.truth.hits > 0).all()


def test_the_guide_has_an_api_page_for_every_public_module():
    pages = {path.stem for path in (ROOT / "docs/api").glob("*.md")}
    public = {*lidar_core._LAZY} - {"reproduce"}
    assert pages == {"lidar_core", *public}


def test_make_help_lists_the_targets():
    done = subprocess.run(
        ["make", "--no-print-directory", "help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert set(re.findall(r"^  make (\S+)", done.stdout, re.MULTILINE)) >= TARGETS


def test_one_version_everywhere():
    version = tomllib.loads(text_of("Cargo.toml"))["workspace"]["package"]["version"]
    assert lidar_core.__version__ == version
    assert f'__version__ = "{version}"' in text_of("training/lidar_core_training/__init__.py")
    assert re.search(r"^## \[?Unreleased", text_of("CHANGELOG.md"), re.MULTILINE)


RUST_LIMITS = {
    "lidar_core/src/util/budget.rs": ("MAX_POINTS", "MAX_VOXELS_PER_RAY", "MAX_SENSORS"),
    "lidar_core/src/util/threads.rs": ("MAX_THREADS",),
    "lidar_core/src/flying/track/parameters.rs": ("MAX_TRACKS",),
    "lidar_core/src/fusion/targets/many/parameters.rs": ("MAX_TARGETS",),
    "lidar_core/src/circles/map/parameters.rs": ("MAX_ELEMENTS",),
    "lidar_sim/src/mesh.rs": ("MAX_FACES",),
}
PYTHON_LIMITS = {
    "batch.config": ("MOST_JOBS", 1, ""),
    "files": ("MOST_TEXT_BYTES", 2**20, " MiB"),
    "io.child.limits": ("MEMORY", 2**30, " GiB"),
    "io.formats.carmen": ("MAX_UNPACKED_BYTES", 2**30, " GiB"),
    "io.formats.ros": ("MAX_TOPICS", 1, ""),
    "io.messages.cloud": ("MAX_POINT_BYTES", 1, ""),
    "io.poses.pose_files": ("MAX_FILE_BYTES", 2**20, " MiB"),
    "live.config": ("MAX_POSES", 1, ""),
    "live.sources.inbox": ("MAX_TOPICS", 1, ""),
    "runs.checkpoints": ("MOST_BYTES", 2**30, " GiB"),
}


def test_the_limits_of_the_security_paper_are_those_of_the_code():
    paper = text_of("SECURITY.md").partition("\n## Limits\n")[2]
    told = set(re.findall(r"[\d,]*\d(?: [MG]iB)?", paper))
    for file, names in RUST_LIMITS.items():
        for name in names:
            value = re.search(rf"{name}: usize = ([\d_]+);", text_of(f"rust/{file}"))[1]
            assert f"{int(value.replace('_', '')):,}" in told, (file, name)
    for module, (name, unit, word) in PYTHON_LIMITS.items():
        value = getattr(importlib.import_module(f"lidar_core.{module}"), name)
        assert f"{value // unit:,}{word}" in told, (module, name)
    read, flying = model_named("read")(), model_named("flying")()
    assert f"{read.max_record_bytes // 2**20} MiB" in told
    for value in [read.max_points, flying.voxel_map.max_voxels]:
        assert f"{value:,}" in told


def test_the_attacks_of_the_security_paper_are_those_of_the_code():
    from hostile.kills import works

    paper = " ".join(text_of("SECURITY.md").split())
    assert len(works(1)) == 15
    assert "`make kills` kills fifteen commands" in paper
    planted = {int(number) for number in re.findall(r"canary_(\d+)", text_of("Cargo.toml"))}
    assert planted == set(range(1, 11))
    assert "in a build with ten planted bugs" in paper
    stopped = re.search(r"CALLS = \((.*)\)", text_of("tests/python/base/test_stop.py"))[1]
    assert stopped.count(",") + 1 == 7
    assert "in seven kinds of calls with two million points each" in paper


# Configuration


def test_every_configuration_model_can_be_reached_by_name():
    for module in modules():
        importlib.import_module(module)
    reached = {model for name in MODELS for model in models_within(model_named(name))}
    pending, missing = [Config], []
    while pending:
        model = pending.pop()
        pending.extend(model.__subclasses__())
        if model.__module__.startswith("lidar_core.") and model is not Config:
            missing += [model.__name__] * (model not in reached)
    assert missing == [], "name the model in lidar_core.parameters.MODELS"


def test_the_citation_is_of_this_version_and_invents_no_author():
    text = text_of("CITATION.cff")
    assert re.search(r"^version: (.*)$", text, re.MULTILINE)[1] == lidar_core.__version__
    own, _, papers = text.partition("references:")
    assert "Placeholder" in own
    assert "given-names" not in own
    assert papers.count("doi:") == 2


def test_the_schema_is_the_golden_one():
    golden = json.loads(text_of("tests/golden/config.schema.json"))
    now = {name: model_named(name).model_json_schema() for name in MODELS}
    assert now == golden, "if this change is intended: make golden, and a line in the changelog"


def test_the_parameter_page_has_a_row_for_every_parameter():
    page = runpy.run_path(str(ROOT / "docs/generate_parameters.py"))["page"]()
    for name in MODELS:
        for model in models_within(model_named(name)):
            assert f"### {model.__name__}\n" in page
            assert all(f"| `{field}` |" in page for field in model.model_fields)


def test_every_parameter_is_used_by_a_test_an_example_a_page_or_an_item():
    """A parameter that none of them names is not worth its place, or not tested."""
    places = ("tests", "examples", "docs", "benches", "training", "python/lidar_core/reproduce")
    kinds = {".py", ".md", ".toml", ".ipynb"}
    paths = [path for place in places for path in (ROOT / place).rglob("*") if path.suffix in kinds]
    words = {word for path in paths for word in re.findall(r"\w+", path.read_text("utf-8"))}
    models = {model for name in MODELS for model in models_within(model_named(name))}
    fields = {f"{model.__name__}.{field}" for model in models for field in model.model_fields}
    assert len(fields) <= MOST_PARAMETERS, "a new parameter takes the place of another one"
    assert [name for name in sorted(fields) if name.partition(".")[2] not in words] == []


# The compiled module and the package


def test_the_stub_lists_what_the_module_holds():
    tree = ast.parse(text_of("python/lidar_core/_core.pyi"))
    (listed,) = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "__all__"
    ]
    assert listed == sorted(listed)
    held = {name for name in dir(_core) if not name.startswith("_")} | {"__version__"}
    assert set(listed) == held == set(_core.__all__) | {"__version__"}


@pytest.mark.parametrize("name", modules())
def test_what_a_module_exports_is_there_and_sorted(name):
    module = importlib.import_module(name)
    names = getattr(module, "__all__", [])
    in_order = sorted(names, key=lambda name: (not name.isupper(), not name[0].isupper(), name))
    assert list(names) == in_order, "constants, classes, functions, as ruff sorts them"
    assert [name for name in names if not hasattr(module, name)] == []
    assert module.__doc__


def test_every_public_part_is_listed():
    listed = dir(lidar_core)
    assert set(lidar_core._LAZY) | set(lidar_core._HOMES) <= set(lidar_core.__all__) <= set(listed)
    assert listed == sorted(set(listed))


def test_dir_shows_the_api_alone():
    parts, shown = [lidar_core], []
    while parts:
        part = parts.pop()
        shown.append(part.__name__)
        assert dir(part) == sorted(part.__all__), part.__name__
        inside = (getattr(part, name) for name in dir(part))
        parts += [thing for thing in inside if isinstance(thing, ModuleType)]
    assert {"lidar_core.sim.scenes", "lidar_core.sim.surfaces", "lidar_core.io"} <= set(shown)


def test_the_entry_point_is_the_command():
    (found,) = entry_points(group="console_scripts", name="lidar-core")
    assert callable(found.load())
    command = Path(sys.executable).with_name("lidar-core")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"lidar-core {lidar_core.__version__}\n"


# Rules


def test_no_unsafe_rust():
    for path in first_party_rust():
        code = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
        assert not re.search(r"\bunsafe\b", code), path
    workspace = tomllib.loads(text_of("Cargo.toml"))
    assert workspace["workspace"]["lints"]["rust"]["unsafe_code"] == "forbid"
    assert workspace["profile"]["release"]["panic"] == "unwind"
    for member in workspace["workspace"]["members"]:
        manifest = tomllib.loads(text_of(f"{member}/Cargo.toml"))
        assert manifest["lints"] == {"workspace": True}, member


@pytest.mark.parametrize("folder", ["python", "training", "examples", "docs"])
def test_no_pickle_and_no_code_from_strings(folder):
    words = re.compile(rf"\b({'|'.join([*FORBIDDEN_CALLS, *FORBIDDEN_IMPORTS, 'allow_pickle'])})\b")
    for path in (ROOT / folder).rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if words.search(text) else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in FORBIDDEN_CALLS, path
            if isinstance(node, ast.Import):
                assert not FORBIDDEN_IMPORTS & {name.name for name in node.names}, path
            if isinstance(node, ast.ImportFrom):
                assert node.module not in FORBIDDEN_IMPORTS, path
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert ast.literal_eval(node.value) is False, path


def test_the_core_needs_no_python_and_no_simulator():
    manifest = tomllib.loads(text_of("rust/lidar_core/Cargo.toml"))
    assert set(manifest["dependencies"]) == {
        "libm",
        "nalgebra",
        "postcard",
        "pulp",
        "rayon",
        "serde",
    }
    bindings = re.compile(r"\b(pyo3|numpy|parry|glam)\b")
    for path in (ROOT / "rust/lidar_core/src").rglob("*.rs"):
        assert not bindings.search(re.sub(r"//.*", "", path.read_text(encoding="utf-8"))), path


def test_parry_has_one_door():
    sources = (ROOT / "rust/lidar_sim/src").rglob("*.rs")
    users = [path.name for path in sources if re.search(r"\b(parry3d|glam)::", path.read_text())]
    assert users == ["parry.rs"]
