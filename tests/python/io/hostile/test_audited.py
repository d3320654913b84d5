"""Readers do nothing but read; the watch that says so sees what is not reading."""

import sys

import pytest
from hostile_runs import hostile

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks as on Linux")

DEEDS = {
    "exec('1')": "exec ",
    "import pickle; pickle.loads(pickle.dumps(print))": "pickle.find_class ",
    "import socket; socket.socket()": "socket.__new__ ",
    "import subprocess; subprocess.run(['true'])": "subprocess.Popen ",
    "import os; os.system('true')": "os.system ",
    "open('/etc/hostname')": "open /etc/hostname",
    "path.read_bytes()": None,
}


@pytest.mark.parametrize(("deed", "found"), DEEDS.items())
def test_what_is_not_reading_is_found(tmp_path, deed, found):
    program = (
        "from pathlib import Path\n"
        "from hostile.audited import Watch, read\n"
        "from hostile.seeds import Seed\n"
        f"def deed(path):\n    {deed}\n"
        f"place = Path({str(tmp_path / 'seed')!r})\n"
        "print(*read(Seed('a.csv', b'1', ()), deed, place, Watch()), sep='\\n')\n"
    )
    status, told = hostile("-c", program)
    assert status == 0, told
    if found is None:
        assert told == "\n"
    else:
        assert any(line.startswith(found) for line in told.splitlines()), told


@pytest.mark.nightly
def test_readers_only_read():
    status, told = hostile("-m", "hostile.audited")
    assert status == 0, told
