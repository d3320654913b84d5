"""Every vector unit of the CPU gives the bits of the golden files, on any number of threads."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

from golden.scenes import FILES
from lidar_core._core import vector_unit, vector_units

TESTS = Path(__file__).resolve().parents[2]
FEW = ("yard, best", "dropped rows, sky found", "rosette, sky found", "map, best", "functions")
"""Scenes that use every kernel."""
WRONG = """
import numpy as np
import lidar_core as lc
def cluster():
    lc.cluster_points(np.ones((3, 3), np.float32), max_distance=1.0, min_points=1)
for made in (lc.VoxelMap, lc.flying.FlyingObjectDetector, cluster):
    try:
        made()
    except lc.ConfigError as error:
        print(error)
"""


def on(unit, *arguments):
    environment = os.environ | {"LIDAR_CORE_SIMD": unit}
    paths = [str(TESTS), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    return subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    ).stdout


def check(unit, threads, scenes):
    told = on(unit, "-m", "golden.vector_units", json.dumps(threads), *scenes)
    found = json.loads(told.splitlines()[-1])
    assert found == {"unit": unit, "differences": []}


@pytest.mark.parametrize("unit", vector_units()[:-1])
def test_every_vector_unit_gives_the_same_bits(unit):
    check(unit, [1, 4], FEW)


@pytest.mark.nightly
@pytest.mark.parametrize("unit", vector_units())
def test_every_vector_unit_gives_the_same_bits_in_every_scene(unit):
    check(unit, [1, 2, 4], FILES["flying"])


CHOOSERS = re.compile(
    r"\b(?:Arch::new|V[34]::try_new|Neon::try_new)\b|feature_detected|target_feature"
)
"""What asks the CPU."""
DYNAMIC = re.compile(r"\bDMatrix\b|\bDVector\b|\bDyn\b")
"""For matrices of dynamic size nalgebra chooses kernels by the CPU, some with fused sums."""


def choosers(sources):
    """Files whose code, tests left out, would get other bits on another CPU."""
    code = {path: text.split("#[cfg(test)]\nmod")[0] for path, text in sources.items()}
    return {path for path, text in code.items() if CHOOSERS.search(text) or DYNAMIC.search(text)}


def test_one_file_chooses_the_unit():
    found = {path.relative_to(ROOT): path.read_text() for path in ROOT.glob("rust/*/src/**/*.rs")}
    assert choosers(found) == {Path("rust/lidar_core/src/util/vector_unit.rs")}
    wrong = {"a": "Arch::new().dispatch(k)", "b": "DMatrix::zeros(n, n)", "c": "dispatch(Kernel)"}
    assert choosers(wrong) == {"a", "b"}


def test_the_best_unit_is_used():
    assert os.environ.get("LIDAR_CORE_SIMD") or vector_unit() == vector_units()[-1]


def test_a_unit_that_the_cpu_lacks_is_refused_by_all_that_use_one():
    expected = (
        "LIDAR_CORE_SIMD: expected scalar, or avx2, avx512, neon where the CPU has it, got sse"
    )
    assert on("sse", "-c", WRONG).splitlines() == [expected] * 3


def test_an_empty_name_is_no_name():
    assert (
        on("", "-c", "import lidar_core._core as core; print(core.vector_unit())").strip()
        == (vector_units()[-1])
    )
