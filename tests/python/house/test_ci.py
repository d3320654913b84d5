"""What `.ci/run` says of the tests of training: that they ran, or why they did not."""

import json
import subprocess
import sys

import pytest
from repository import ROOT

SCRIPT = ROOT / ".ci" / "run"
CUDA = 'nvidia-cudnn-cu13==9.1; platform_system == "Linux"'
PIP = """#!/usr/bin/env python3
import shutil, sys
assert sys.argv[1:3] == ["-m", "pip"], sys.argv
report = sys.argv[sys.argv.index("--report") + 1]
try:
    shutil.copy("index.json", report)
except OSError:
    sys.exit("no such package")
"""
MAKE = """make() {
    echo "make $*"
    echo "===== $TOLD in 3.00s ====="
    case "$TOLD" in *failed*) return 1 ;; esac
}
"""


def check_training(folder, *, requires, index="", told="48 passed"):
    """Status and what the check says, with stand-ins for pip and make; `requires` of torch."""
    text = SCRIPT.read_text()
    functions = text[text.index("check_training() {") : text.index("\ntest_command=")]
    python = folder / ".venv-test" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PIP.replace("/usr/bin/env python3", sys.executable))
    python.chmod(0o755)
    (folder / "dist").mkdir()
    (folder / "dist" / "lidar_core-1.whl").touch()
    if requires is not None:
        report = {"install": [{"metadata": {"requires_dist": requires}}]}
        (folder / "index.json").write_text(json.dumps(report))
    lines = ["set -euo pipefail", "clean_dir=. training_log=log training_told=told", MAKE]
    done = subprocess.run(
        ["bash", "-c", "\n".join([*lines, functions, "check_training"])],
        cwd=folder,
        env={"PATH": "/usr/bin:/bin", "LIDAR_CORE_TORCH_INDEX": index, "TOLD": told},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


def test_training_is_tested_where_torch_for_cpus_can_be_had(tmp_path):
    status, lines = check_training(tmp_path, requires=["sympy"])
    assert status == 0
    assert lines[0] == "make test-training WHEEL=dist/lidar_core-1.whl"
    assert lines[-1] == (tmp_path / "told").read_text().strip() == "===== 48 passed in 3.00s ====="


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="CUDA is for Linux here")
def test_without_torch_for_cpus_ci_says_that_training_was_not_tested(tmp_path):
    status, lines = check_training(tmp_path, requires=["sympy", CUDA])
    assert status == 0
    assert len(lines) == 1
    assert lines[0].startswith("training tests did not run: torch of the package index needs CUDA")
    assert (tmp_path / "told").read_text().splitlines() == lines


def test_an_index_without_torch_is_told(tmp_path):
    status, lines = check_training(tmp_path, requires=None, index="http://nowhere")
    assert status == 0
    assert lines == [
        "training tests did not run: no torch for this Python at LIDAR_CORE_TORCH_INDEX"
    ]


def test_a_training_test_that_fails_fails_the_run(tmp_path):
    status, _ = check_training(tmp_path, requires=["sympy"], told="1 failed, 47 passed")
    assert status != 0


def test_ci_ends_with_the_summaries_and_what_it_says_of_training():
    *_, cargo, pytest_line, training = SCRIPT.read_text().splitlines()
    assert cargo == "grep -E '^test result: ' \"$log\""
    assert pytest_line.startswith("grep -E '^=+ .*(passed|failed|error)")
    assert training == 'cat "$training_told"'
