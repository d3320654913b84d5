"""Other ways to the package: the conda recipe, and the weekly job with the newest dependencies."""

import re
import subprocess
import tomllib

import pytest
from repository import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
BOUND = re.compile(r"(?<=[0-9]),<[0-9.]+")


# The weekly job itself tests without bounds.
pytestmark = pytest.mark.skipif(
    BOUND.search((ROOT / "pyproject.toml").read_text()) is None, reason="the bounds were dropped"
)


@pytest.fixture(scope="module")
def recipe():
    yaml = pytest.importorskip("yaml", reason="needs pyyaml, which the extra `cluster` installs")
    return yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())


def spaced(requirement):
    """A requirement as conda writes it: without marker, a space before the versions."""
    return re.sub(r"(?<=[\w-])(?=[<>=])", " ", requirement.partition(";")[0], count=1).strip()


def test_the_conda_recipe_needs_what_the_package_needs(recipe):
    project = PYPROJECT["project"]
    python = f"python {project['requires-python']}"
    assert recipe["requirements"]["run"] == [python, *map(spaced, project["dependencies"])]
    (build_tool,) = PYPROJECT["build-system"]["requires"]
    assert recipe["requirements"]["host"] == [python, "pip", spaced(build_tool)]


def test_the_conda_recipe_says_what_the_package_says(recipe):
    project = PYPROJECT["project"]
    workspace = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]
    assert recipe["context"]["version"] == workspace["package"]["version"]
    assert recipe["package"]["name"] == project["name"]
    assert recipe["about"]["summary"] == project["description"]
    assert recipe["about"]["license"] == project["license"]
    assert set(project["license-files"]) < set(recipe["about"]["license_file"])
    commands = [f"{name} = {place}" for name, place in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == commands


def test_the_weekly_job_drops_every_upper_bound_and_nothing_else(tmp_path):
    text = (ROOT / ".github" / "workflows" / "newest.yml").read_text()
    assert "schedule:" in text
    assert "- run: cargo update" in text
    assert "- run: make test" in text
    (told,) = re.findall(r"sed -i -E '(.*)' pyproject.toml", text)
    copy = tmp_path / "pyproject.toml"
    copy.write_text((ROOT / "pyproject.toml").read_text())
    subprocess.run(["sed", "-i", "-E", told, copy], check=True)
    before = (ROOT / "pyproject.toml").read_text()
    assert len(BOUND.findall(before)) >= 5
    assert tomllib.loads(copy.read_text()) == tomllib.loads(BOUND.sub("", before))
