"""`lidar-core simulate`."""

import json
import re
from pathlib import Path

from typer.testing import CliRunner

from lidar_core import ConfigError
from lidar_core.cli import app


def run_command(*arguments):
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def test_the_command_writes_the_same_bytes_again(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[lidar]\npreset = "vlp-16"\n[[bodies]]\nshape = {kind = "plane"}\n')
    hashes = set()
    for name in ("a.npz", "b.npz"):
        out = run_command(scene, "-o", tmp_path / name, "--seed", 1, "--scans", 2, "--json")
        assert out.exit_code == 0, out.output
        done = json.loads(out.stdout)
        assert done["scans"] == 2
        assert done["points"] > 1000
        hashes.add(re.search(r'sha256 = "(\w{64})"', Path(done["run"]).read_text())[1])
    assert len(hashes) == 1
    out = run_command("performance-2", "-o", tmp_path / "c.npz", "--scans", 1)
    assert out.exit_code == 0
    assert "1 scans, 98633 points" in out.output


def test_the_command_refuses_what_it_cannot_write(tmp_path):
    out = run_command("demo", "-o", tmp_path / "x.bag")
    assert isinstance(out.exception, ConfigError)
    assert "x.bag: expected a name that ends in .npz or .mcap" in str(out.exception)
    assert list(tmp_path.iterdir()) == []
    out = run_command(tmp_path / "none.toml", "-o", tmp_path / "x.npz")
    assert isinstance(out.exception, FileNotFoundError)
