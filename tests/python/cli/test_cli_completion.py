"""Completion of topics: the shell offers those of the recording on the line."""

import os
import subprocess

import numpy as np
import pytest
from commands import command_line

import lidar_core as lc
from lidar_core.messages import Scan


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("completion") / "a.mcap"
    cloud = np.ones((5, 3), np.float32)
    lc.io.write_recording(path, [Scan(stamp_ns=0, points=cloud, frame_id="lidar")])
    return path


def offered(*words):
    """What the shell is offered for the last of the words."""
    line = " ".join(["lidar-core", *map(str, words)])
    environment = os.environ | {
        "_LIDAR_CORE_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words)),
    }
    done = subprocess.run(
        command_line(),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env=environment,
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.nightly
def test_topics_of_the_kind_that_the_option_takes(recording):
    (cloud,) = (topic.name for topic in lc.io.open_recording(recording).topics())
    assert offered("detect", recording, "--cloud", cloud[:1]) == [cloud]
    assert offered("convert", recording, "b.npz", "--topic", cloud[:1]) == [cloud]
    assert offered("detect", recording, "--cloud", cloud + "x") == []
    assert offered("circles", recording, "--scan", cloud[:1]) == []  # it has no 2D scans


def test_a_line_without_a_recording_is_offered_nothing(tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no recording")
    assert offered("detect", "--cloud", "/") == []
    assert offered("detect", tmp_path / "nowhere.bag", "--cloud", "/") == []
    assert offered("detect", broken, "--cloud", "/") == []
