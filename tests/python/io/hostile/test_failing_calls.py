"""Disks that fail at any call of a writer: an OSError, the old file, and no litter."""

import json
import os
import shutil
import subprocess
import sys

import pytest
from repository import ROOT

from hostile import failing_calls

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None,
    reason="needs a C compiler, and calls as on Linux",
)
LEAST_CALLS = 4
"""Of every writer: open, write, sync, rename."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Rows of every writer."""
    folder = tmp_path_factory.mktemp("failing")
    library = folder / "failing_calls.so"
    source = ROOT / "tests" / "hostile" / "failing_calls.c"
    built = ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"]
    subprocess.run(built, check=True)
    paths = [str(ROOT / "tests"), os.environ.get("PYTHONPATH")]
    done = subprocess.run(
        [sys.executable, "-m", "hostile.failing_calls", str(folder)],
        env={
            **os.environ,
            "LD_PRELOAD": str(library),
            "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", failing_calls.WRITERS)
def test_the_old_file_or_the_new_one_is_there(outcomes, name):
    rows = outcomes[name]
    assert len(rows) > LEAST_CALLS, rows
    assert rows[0]["said"] == "ok "
    assert not rows[0]["old"]  # nothing failed: the new file is there
    for row in rows[1:]:
        # zipfile opens a second time in another way: then the new file is there.
        is_written = row["said"] == "ok " and not row["old"]
        assert is_written or row["said"].startswith("typed OSError"), row
        assert row["litter"] == [], row
    assert sum(row["old"] for row in rows[1:]) >= LEAST_CALLS - 1
