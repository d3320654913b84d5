"""`lidar-core train` and `lidar-core export` where the training distribution is missing."""

import sys

import pytest
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import MissingExtraError
from lidar_core.extras import install_command


@pytest.mark.parametrize(
    "arguments", [["train", "circles", "-c", "c.toml", "-o", "run"], ["export", "run", "m.onnx"]]
)
def test_the_error_says_how_to_install_it(arguments, monkeypatch):
    for name in [name for name in sys.modules if name.startswith("lidar_core_training")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lidar_core_training", None)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, MissingExtraError)
    assert str(result.exception).endswith(f": {install_command('train')}")
