"""Every cut and every damaged byte of a good file of each format."""

import json
import os
import subprocess
import sys

import pytest
from repository import ROOT

from hostile import evidence
from hostile.exhaustive import corruptions

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and fork as on Linux")
FORMATS = 20
"""Formats that are attacked at least."""


def exhaustive(folder, *options):
    """Status, counts by format, and what the program said."""
    told = folder / "counts.json"
    paths = [str(ROOT / "tests"), str(ROOT / "tests/python/helpers"), os.environ.get("PYTHONPATH")]
    done = subprocess.run(
        [sys.executable, "-m", "hostile.exhaustive", "--json", str(told), *map(str, options)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, json.loads(told.read_text()), done.stdout + done.stderr


def test_corruptions_are_all_there_and_none_is_the_file_itself():
    data = bytes([0x00, 0xFF, 0x01])
    made = list(corruptions(data, 1))
    assert len(made) == 3 * 5 - 2  # 0x00 and 0xFF stay what they are
    assert all(broken != data for _, broken in made)
    assert {broken for what, broken in made if what.startswith("cut")} == {
        b"",
        b"\x00",
        b"\x00\xff",
    }


def test_some_offsets_of_every_format(tmp_path):
    status, counts, told = exhaustive(tmp_path, "--step", 24001)
    assert status == 0, told
    assert len(counts) >= FORMATS, sorted(counts)
    assert all(one.get("ok", 0) == 0 for name, one in counts.items() if name in (".lcst", ".lcvm"))


def test_a_reader_that_ends_badly_is_found(tmp_path):
    """The opposite: the program tells and fails, and goes on behind the file."""
    program = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from hostile.exhaustive import attack\n"
        "from hostile.seeds import Seed\n"
        "def entry(path):\n"
        "    data = path.read_bytes()\n"
        "    if len(data) == 3: os.abort()\n"
        "    if data[:1] == b'\\xff': raise KeyError('no')\n"
        "folder = Path(sys.argv[1])\n"
        "totals, bad = attack(Seed('a.x', b'abcdef', (entry,)), entry, 1, folder)\n"
        "print(sorted(totals.items()), len(bad))\n"
        "totals, bad = attack(Seed('a.lcst', b'ab', (entry,)), entry, 1, folder)\n"
        "print(totals['accepted though sealed'], len(bad))\n"
    )
    paths = [str(ROOT / "tests"), str(ROOT / "tests/python/helpers")]
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    expected = "[('abort', 1), ('ok', 28), ('untyped', 1)] 2\n9 10\n"
    assert done.stdout == expected, done.stderr


@pytest.mark.nightly
def test_every_offset_of_every_format(tmp_path):
    status, _, told = exhaustive(tmp_path)
    assert status == 0, told


def test_counts_add_up_and_the_guide_shows_them(tmp_path):
    file = tmp_path / "evidence" / "evidence.json"
    for outcomes in ({"a": {"ok": 1, "abort": 2}}, {"a": {"ok": 3}, "b": {"typed": 4}}):
        evidence.add("attack", outcomes, file)
    known = json.loads(file.read_text())
    assert known == {"attack": {"a": {"abort": 2, "ok": 4}, "b": {"typed": 4}}}
    page = evidence.PAGE.read_text()
    assert "| attack | `a` | 6 | 4 | 0 | 0 | 2 |" in evidence.shown(page, known)
    assert evidence.shown(page, json.loads(evidence.FILE.read_text())) == page


def test_mended_bugs_count_on_and_those_found_later_are_open(tmp_path):
    file = tmp_path / "evidence.json"
    evidence.add("attack", {"a": {"ok": 4, "abort": 2, "hang": 1}, "b": {"hang": 1}}, file)
    assert evidence.mend("attack", "a", file) == 3
    evidence.add("attack", {"a": {"abort": 1, "ok": 1}}, file)
    known = json.loads(file.read_text())
    assert known == {"attack": {"a": {"abort": 1, "mended": 3, "ok": 5}, "b": {"hang": 1}}}
    page = evidence.shown(evidence.PAGE.read_text(), known)
    assert "| attack | `a` | 9 | 5 | 0 | 3 | 1 |" in page
    assert "| attack | `b` | 1 | 0 | 0 | 0 | 1 |" in page
