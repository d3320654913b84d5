"""The container file and the pages on services: commands, extras and variables that exist."""

import re
import tomllib
from dataclasses import fields

import pytest
from repository import ROOT
from ruamel.yaml import YAML
from typer.main import get_command

from lidar_core.cli import app

PAGE = (ROOT / "docs/operate.md").read_text(encoding="utf-8")
RECIPE = (ROOT / "Containerfile").read_text(encoding="utf-8")
MANIFESTS = [YAML(typ="safe").load(text) for text in re.findall(r"```yaml\n(.*?)```", PAGE, re.S)]
EXTRAS = set(
    tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
)


def check(arguments):
    """Parse a call of lidar-core without running it."""
    command, rest = get_command(app), list(map(str, arguments))
    name = rest.pop(0)
    command.commands[name].make_context(name, rest)


def pod_of(manifest):
    return manifest["spec"]["template"]["spec"]


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda one: one["kind"])
def test_manifests_run_commands_that_exist_without_rights(manifest):
    pod = pod_of(manifest)
    assert pod["securityContext"]["runAsNonRoot"]
    (container,) = pod["containers"]
    check(container["args"])
    assert all(one["name"].startswith("LIDAR_CORE_") for one in container["env"])


def test_the_manifests_are_a_job_and_a_deployment():
    assert {one["kind"] for one in MANIFESTS} == {"Job", "Deployment"}


def test_the_image_runs_the_demo_as_a_user_without_rights():
    lines = RECIPE.splitlines()
    users = [line.split()[1] for line in lines if line.startswith("USER ")]
    bases = [line.split()[1] for line in lines if line.startswith("FROM ")]
    assert users == ["lidar"]
    assert "useradd" in RECIPE
    assert bases[-1].startswith("docker.io/library/debian:")
    assert lines[-2:] == ['ENTRYPOINT ["lidar-core"]', 'CMD ["demo"]']


def test_extras_of_the_image_exist():
    given = re.findall(r"EXTRAS=([\w,]+)", RECIPE + PAGE)
    assert len(given) >= 3
    for extras in given:
        assert set(extras.split(",")) <= EXTRAS


def test_options_of_the_guides_tool_are_known_to_it():
    """It only warns, and only where pydantic is missing."""
    handler = pytest.importorskip("mkdocstrings_handlers.python")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    block = re.search(r"          options:\n((?:            .*\n)+)", text)[1]
    given = YAML(typ="safe").load(block)
    assert len(given) > 5
    assert set(given) <= {one.name for one in fields(handler.PythonInputOptions)}
