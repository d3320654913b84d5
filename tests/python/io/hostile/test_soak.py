"""`make soak` counts every scan, and tells growth and slowing down."""

import sys

import pytest

from endurance import soak

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory as Linux tells it")


@pytest.mark.ci_cases("well", "grows")
@pytest.mark.parametrize(
    ("limits", "status"),
    [((1e9, 1e9), 0), ((-1e9, 1e9), 1), ((1e9, 0.0), 1)],
    ids=["well", "grows", "slows down"],
)
def test_a_short_loop(limits, status, monkeypatch, capsys):
    growth, slower = map(str, limits)
    options = ["--scans", "20", "--points", "1024", f"--growth={growth}", f"--slower={slower}"]
    monkeypatch.setattr(sys, "argv", ["soak", *options])
    assert soak.main() == status
    assert "20 processed, 0 held, 0 rejected, 0 lost" in capsys.readouterr().out
