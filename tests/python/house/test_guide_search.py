"""The search of the guide: who looks for a sensor finds the section about it first."""

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from repository import ROOT

from lidar_core.sensors import SENSORS

NODE = shutil.which("node") or shutil.which("nodejs")
needs_search = pytest.mark.skipif(
    NODE is None or find_spec("material") is None,
    reason="the search of the guide needs Node.js and mkdocs-material",
)
CONFIG = """
site_name: a
docs_dir: docs
site_dir: site
theme: {name: material, font: false}
plugins: [search]
exclude_docs: "*.py"
"""
MAKERS = ["hokuyo", "sick", "slamtec", "rplidar", "ouster", "velodyne", "livox", "hesai"]
NAMES = ["robosense", "mid-360", "mid360", "avia", "hap", "os1", "puck vlp-16", "pandarxt-32"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The pages of the guide with their search, without notebooks and the reference of the API."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "mkdocs.yml").write_text(CONFIG)
    left_out = shutil.ignore_patterns("notebooks", "api", "images")
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=left_out)
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-q"],
        cwd=folder,
        check=True,
        capture_output=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    return folder / "site"


def found_first(site, queries):
    script = Path(__file__).parents[1] / "helpers" / "guide_search.js"
    done = subprocess.run(
        [NODE, script, site, *queries], check=True, capture_output=True, text=True, timeout=300
    )
    return dict(json.loads(line) for line in done.stdout.splitlines())


@needs_search
def test_every_name_of_a_sensor_finds_its_section_first(site):
    names = [*SENSORS, *(sensor.title.lower() for sensor in SENSORS.values()), *MAKERS, *NAMES]
    found = found_first(site, names)
    assert len(found) == len(set(names))
    assert not {
        name: places
        for name, places in found.items()
        if not places or not places[0].startswith("choose-your-sensor/#")
    }


@needs_search
def test_a_name_finds_the_section_of_its_maker(site):
    begins = dict.fromkeys(["hokuyo", "sick", "slamtec"], "2d-")
    # Numbers of rows are in the names of several makers: of os0-64 the page is first.
    sensors = {name: one for name, one in SENSORS.items() if not name.startswith("os")}
    found = found_first(site, [*sensors, "os0", "os1", "os2"])
    for name, places in found.items():
        maker = sensors[name].title.split()[0].lower() if name in sensors else "ouster"
        begin = f"choose-your-sensor/#{begins.get(maker, maker)}"
        assert places[0].startswith(begin), (name, places)


@needs_search
def test_what_is_no_sensor_is_found_elsewhere(site):
    """The page of the sensors does not displace the others."""
    found = found_first(site, ["install", "covariance", "tuning", "batch", "radar", "foxglove"])
    assert all(places for places in found.values())
    assert not [name for name, places in found.items() if places[0].startswith("choose-your")]
