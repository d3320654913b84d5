"""Live streams: the inbox, poses as they come, the loop; robots and viewers in other processes."""

import json
import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections import Counter
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core import PointClass
from lidar_core.circles import CirclesConfig
from lidar_core.cli import app
from lidar_core.cli.live import _since_stamp
from lidar_core.errors import ConfigError, FormatError, InputError, LinkError
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import NoTransformError, PoseOptions, ReadOptions, Topic
from lidar_core.io.messages.ros_types import DETECTIONS_TYPE, ros_store
from lidar_core.io.poses.posed import span_ns
from lidar_core.io.records import Record, decoded
from lidar_core.io.tables.columns import read_columns
from lidar_core.io.write.mcap import FoxgloveLog
from lidar_core.io.write.ros import RosMessages
from lidar_core.io.write.ros_obstacles import ObstacleArrays
from lidar_core.live import Inbox, LiveConfig, LiveLoop, Output, Source
from lidar_core.live.outputs.output import McapOutput, RerunOutput
from lidar_core.live.pipelines import CirclesLive, FlyingLive, LivePipeline
from lidar_core.live.poses import LivePoses
from lidar_core.live.sources.foxglove import FoxgloveSource
from lidar_core.live.sources.replay import ReplaySource
from lidar_core.live.sources.source import StreamTopics
from lidar_core.live.sources.zenoh import ZenohSource
from lidar_core.live.stats import LiveStats, Report
from lidar_core.live.zenoh_link import key_of, topic_of
from lidar_core.messages import LaserScan, Pose, Scan
from lidar_core.run_folder import RunFolder
from lidar_core.runs.streams.choice import PipelineChoice
from lidar_core.runs.streams.folder import LiveFolder

PATIENCE_S = 60
MAIN = "from lidar_core.cli import main; main()"
SCANS = 40
ROBOT = ROOT / "examples" / "robot_on_zenoh.py"
LASER, TF = Topic("/scan", "", "planar"), Topic("/tf", "", "pose")
ODOM = Topic("/odom", "nav_msgs/msg/Odometry", "pose")


def laser(stamp_ns, **more):
    ranges = np.full(10, 3.0, np.float32)
    return LaserScan(stamp_ns, ranges, -1.0, 0.2, 0.1, 20.0, topic="/scan", **more)


def pose(stamp_ns, x=0.0, parent="odom", child="laser", **more):
    matrix = np.eye(4)
    matrix[0, 3] = x
    return Pose(stamp_ns, parent, child, matrix, **more)


def record(topic, message):
    return Record(topic, message.stamp_ns, decoded(message))


# The inbox


def test_the_newest_scan_replaces_one_that_waits():
    inbox = Inbox(max_poses=3)
    for stamp in range(5):
        inbox.put(record(LASER, laser(stamp)))
        inbox.put(record(TF, pose(stamp)))
    batch = inbox.take(0)
    assert [item.record.time_ns for item in batch.scans] == [4]
    assert [item.record.time_ns for item in batch.poses] == [2, 3, 4]
    assert inbox.dropped == {"/scan": 4, "/tf": 2}
    assert inbox.take(0).scans == []


def test_an_inbox_is_bounded_whatever_topics_come():
    inbox = Inbox(max_poses=3)
    for number in range(1000):
        inbox.put(record(Topic(f"/{number}", "", "planar"), laser(0)))
    assert len(inbox.take(0).scans) == 64
    assert inbox.dropped.total() == 1000 - 64
    assert len(inbox.dropped) == 1


def test_the_error_of_a_source_is_raised_where_the_loop_is():
    inbox = Inbox(max_poses=3)
    inbox.fail(LinkError("gone"))
    with pytest.raises(LinkError, match="gone"):
        inbox.take(0)


# Poses


def test_a_scan_is_complete_once_its_last_ray_has_a_pose():
    poses = LivePoses(PoseOptions(), LiveConfig())
    scan = laser(1000, time_increment_ns=100)  # ends at 1900
    poses.add(TF, pose(900, 0.0), "laser")
    assert not poses.is_complete(scan)
    poses.add(TF, pose(1899, 1.0), "laser")
    assert not poses.is_complete(scan)
    poses.add(TF, pose(2000, 1.0), "laser")
    assert poses.is_complete(scan)
    posed = poses.posed(scan)
    np.testing.assert_array_equal(posed.pose_stamps_ns, [1000, 1899, 1900])
    assert posed.world_from_lidar[1, 0, 3] == pytest.approx(1.0)
    assert poses.fixed_frame == "odom"


def test_odometry_counts_where_transforms_move_nothing():
    poses = LivePoses(PoseOptions(), LiveConfig())
    poses.add(TF, pose(0, 2.0, "base", "laser", is_static=True), "")
    assert not poses.is_complete(laser(100))
    with pytest.raises(NoTransformError, match=r"transforms: base -> laser; odometry: none"):
        poses.posed(laser(100))
    poses.add(ODOM, pose(100, 5.0, "odom", "base"), "")
    assert poses.posed(laser(100)).world_from_lidar[0, 3] == 7.0
    poses.add(TF, pose(100, 1.0, "map", "odom"), "")  # too late to change the fixed frame
    assert poses.posed(laser(100)).world_from_lidar[0, 3] == 7.0
    assert poses.fixed_frame == "odom"


def test_odometry_of_a_second_topic_is_refused_if_it_begins_soon_and_noted_later():
    other = Topic("/other_car", ODOM.type, ODOM.kind)
    poses, notes = LivePoses(PoseOptions(), LiveConfig()), []
    poses.on_note = notes.append
    poses.add(ODOM, pose(100, 5.0, "odom", "laser"), "")
    assert poses.posed(laser(100)).world_from_lidar[0, 3] == 5.0
    poses.add(other, pose(200, 9.0, "odom", "laser"), "")  # one pose alone, such as a goal
    with pytest.raises(ConfigError, match=r"/other_car have odometry; .* odom='/other_car'"):
        poses.add(other, pose(300, 9.0, "odom", "laser"), "")
    # Both may come before the first scan.
    early = LivePoses(PoseOptions(), LiveConfig())
    for stamp in (100, 200):
        early.add(ODOM, pose(stamp, 5.0, "odom", "laser"), "")
        early.add(other, pose(stamp, 9.0, "odom", "laser"), "")
    with pytest.raises(ConfigError, match=r"/odom, /other_car have odometry"):
        early.posed(laser(200))
    goal = LivePoses(PoseOptions(), LiveConfig())
    goal.add(other, pose(100, 9.0, "odom", "laser"), "")
    for stamp in (100, 200):
        goal.add(ODOM, pose(stamp, 5.0, "odom", "laser"), "")
    assert goal.posed(laser(200)).world_from_lidar[0, 3] == 5.0
    # The first topic was alone for a minute, or the user named it.
    late = 60_000_000_000
    calm = LivePoses(PoseOptions(), LiveConfig())
    calm.on_note = notes.append
    named = LivePoses(PoseOptions(odom=ODOM.name), LiveConfig())
    for kept, stamp in ((calm, late), (named, 200)):
        kept.add(ODOM, pose(100, 5.0, "odom", "laser"), "")
        kept.posed(laser(100))
        kept.add(other, pose(stamp, 9.0, "odom", "laser"), "")
        kept.add(other, pose(stamp + 1, 9.0, "odom", "laser"), "")
        kept.add(ODOM, pose(stamp, 6.0, "odom", "laser"), "")
        assert kept.posed(laser(stamp)).world_from_lidar[0, 3] == 6.0
    assert notes == [
        "topic '/other_car' has odometry, too; that of '/odom' stays in use (odom=TOPIC)"
    ]


@pytest.mark.parametrize("first", ["scan", "odometry"])
def test_transforms_that_never_change_count_whatever_comes_first(first):
    poses = LivePoses(PoseOptions(odom=ODOM.name), LiveConfig())
    poses.add(TF, pose(0, 2.0, "base", "laser", is_static=True), "")
    if first == "scan":
        assert not poses.is_complete(laser(100))
    poses.add(ODOM, pose(100, 5.0, "odom", "base"), "")
    assert poses.posed(laser(100)).world_from_lidar[0, 3] == 7.0


def test_poses_without_child_frame_are_those_of_the_sensor_or_what_carries_it():
    plain = LivePoses(PoseOptions(), LiveConfig())
    plain.add(ODOM, pose(100, 5.0, child=""), "laser")
    assert plain.posed(laser(100)).world_from_lidar[0, 3] == 5.0
    mounted = LivePoses(PoseOptions(mounting=("base laser 1 0 0 0 0 0",)), LiveConfig())
    mounted.add(ODOM, pose(100, 5.0, child=""), "laser")
    assert mounted.posed(laser(100)).world_from_lidar[0, 3] == 6.0


def test_poses_are_forgotten_and_frames_are_limited(monkeypatch):
    monkeypatch.setattr("lidar_core.live.poses.POSE_HISTORY", 1.0)
    monkeypatch.setattr("lidar_core.live.poses.MAX_FRAMES", 5)
    poses = LivePoses(PoseOptions(), LiveConfig())
    for stamp in range(100):
        poses.add(TF, pose(stamp * 10**9), "laser")
        poses.add(TF, pose(stamp * 10**9, child=f"other{stamp}"), "laser")
        poses.posed(laser(stamp * 10**9))
    with pytest.raises(NoTransformError):
        poses.posed(laser(90 * 10**9))
    assert poses.dropped == {"/tf": 100 - 4}


def test_a_sensor_that_stands_is_where_it_is_mounted():
    options = PoseOptions(pose="static", mounting=("floor laser 0 0 2 0 0 0",))
    poses = LivePoses(options, LiveConfig())
    assert poses.is_complete(laser(0))
    assert poses.posed(laser(0)).world_from_lidar[2, 3] == 2.0
    assert poses.fixed_frame == "floor"
    with pytest.raises(ConfigError, match="expected auto, static or kiss for a live stream"):
        LivePoses(PoseOptions(pose="poses.txt"), LiveConfig())


# The loop


class Played(Source):
    """Plays (delay [s], record) pairs; without a delay, once what came before was taken."""

    def __init__(self, *items):
        super().__init__("a test")
        self.items = items

    def start(self, inbox):
        def play():
            for delay, item in self.items:
                time.sleep(delay or 0)
                while delay is None and inbox._has_news():
                    time.sleep(0.001)
                inbox.put(item)
            inbox.finish()

        Thread(target=play, daemon=True).start()

    def close(self):
        pass


class Slow(LivePipeline):
    """Takes its time."""

    capability, sort = "circles", LaserScan

    def __init__(self, seconds):
        self.seconds, self.taken = seconds, []

    def take(self, item, frame_id):
        time.sleep(self.seconds)
        self.taken.append(item.scan.stamp_ns)
        return "refused by the test"


def run_loop(source, pipeline, *, pose="static", on_reason=lambda reason: None, **config):
    poses = LivePoses(PoseOptions(pose=pose), LiveConfig(**config))
    loop = LiveLoop(
        source,
        lambda sort: pipeline if sort is LaserScan else None,
        poses,
        [],
        LiveConfig(**config),
        on_reason=on_reason,
    )
    loop.run(PATIENCE_S)
    return loop.summary()


def test_a_slow_pipeline_gets_the_newest_scan_and_drops_are_counted():
    pipeline = Slow(0.1)
    items = [(0.01, record(LASER, laser(stamp))) for stamp in range(60)]
    summary = run_loop(Played(*items), pipeline)
    assert pipeline.taken == sorted(pipeline.taken)
    assert pipeline.taken[-1] == 59
    assert 3 <= len(pipeline.taken) <= 25
    assert summary["dropped"] == {"/scan": 60 - len(pipeline.taken)}
    assert summary["rejected"] == {"refused by the test": len(pipeline.taken)}


class Late(Slow):
    """Rejects every scan with its own stamp, and every third one for its size."""

    def take(self, item, frame_id):
        self.taken.append(item.scan.stamp_ns)
        if item.scan.stamp_ns % 3 == 0:
            return f"ranges: expected {item.scan.stamp_ns} rays"
        return f"stamp_ns: expected a stamp after 1796, got {item.scan.stamp_ns}"


def test_reasons_that_differ_in_their_numbers_are_printed_and_counted_once():
    told = []
    items = [(None, record(LASER, laser(stamp))) for stamp in range(1, 10)]
    summary = run_loop(Played(*items), Late(0), on_reason=told.append)
    assert told == ["stamp_ns: expected a stamp after 1796, got 1", "ranges: expected 3 rays"]
    assert summary["rejected"] == {told[0]: 6, told[1]: 3}


class Ordered(Slow):
    """Takes scans in the order of their stamps, as long as one may come half a second late."""

    def take(self, item, frame_id):
        stamp_ns = item.scan.stamp_ns
        if self.taken and stamp_ns < max(self.taken) - 5 * 10**8:
            return f"scan of {stamp_ns} ns: raise `buffer_time`"
        self.taken.append(stamp_ns)
        return SimpleNamespace(stamp_ns=stamp_ns, objects=SimpleNamespace(id=[]))


def test_a_clock_that_went_back_is_named_as_such():
    """A little late is late; far back, no parameter helps."""
    told = []
    stamps = [round(seconds * 1e9) for seconds in (30, 31, 30.2, 9, 9.1, 9.2)]
    items = [(None, record(LASER, laser(stamp))) for stamp in stamps]
    summary = run_loop(Played(*items), Ordered(0), on_reason=told.append)
    back = (
        "/scan: the clock of the source went back by 22.0 s (a loop or a restart of the source):"
        " start live again"
    )
    assert told == ["scan of 30200000000 ns: raise `buffer_time`", back]
    assert summary["rejected"] == {told[0]: 1, back: 3}


def test_a_scan_waits_for_its_pose_and_not_for_ever():
    pipeline = Slow(0)
    stamps = [10**9, 2 * 10**9, 3 * 10**9]
    items = [
        (0, record(TF, pose(0))),
        (0, record(LASER, laser(stamps[0]))),
        (0.05, record(TF, pose(stamps[0]))),  # in time
        (0.05, record(LASER, laser(stamps[1]))),  # never
        (2.0, record(LASER, laser(stamps[2]))),
        (0.02, record(TF, pose(stamps[2]))),
    ]
    summary = run_loop(Played(*items), pipeline, pose="auto", pose_wait=1.0)
    assert pipeline.taken == [stamps[0], stamps[2]]
    (reason,) = summary["without_pose"]
    assert reason.startswith("odom -> laser is known from")


def test_a_scan_that_waited_too_long_gives_way_to_a_newer_one():
    """Otherwise a pipeline that is always late would always be late by two scans."""
    pipeline = Slow(0.3)
    items = [(0, record(TF, pose(0)))]
    for number in range(1, 31):
        items.append((0.03, record(LASER, laser(number * 10**8, time_increment_ns=10**7))))
        items.append((0.02, record(TF, pose((number + 1) * 10**8))))
    summary = run_loop(Played(*items), pipeline, pose="auto", pose_wait=0.1)
    assert summary["dropped"]["/scan"] + len(pipeline.taken) == 30
    assert len(pipeline.taken) >= 3
    assert summary["without_pose"] == {}


def test_scans_whose_poses_never_come_are_counted_with_the_reason_which_is_told_once():
    """They are not dropped for want of time, which a faster computer would cure."""
    pipeline, told = Slow(0), []
    items = [(0.03, record(LASER, laser(number * 10**8))) for number in range(20)]
    summary = run_loop(Played(*items), pipeline, pose="auto", pose_wait=0.05, on_reason=told.append)
    assert pipeline.taken == []
    (reason,) = summary["without_pose"]
    assert reason.startswith("no pose for frame 'laser'")
    assert told == [reason]
    assert summary["without_pose"][reason] + summary["dropped"].get("/scan", 0) == 20
    assert summary["without_pose"][reason] >= 5


def test_other_sorts_and_other_topics_are_ignored_and_counted():
    pipeline = Slow(0)
    cloud = Scan(0, np.zeros((1, 3), np.float32), topic="/cloud")
    items = [(None, record(Topic("/cloud", "", "scan"), cloud)) for _ in range(3)]
    items += [(None, record(LASER, laser(stamp))) for stamp in range(3)]
    items += [(None, record(Topic("/rear", "", "planar"), laser(9))) for _ in range(2)]
    summary = run_loop(Played(*items), pipeline)
    assert pipeline.taken == [0, 1, 2]
    assert summary["ignored"] == {"/cloud": 3, "/rear": 2}


def test_a_message_that_cannot_be_read_is_counted():
    def broken():
        raise FormatError("of the test")

    items = [(None, Record(LASER, 0, broken)), (None, record(LASER, laser(1)))]
    summary = run_loop(Played(*items), Slow(0))
    assert summary["bad_messages"] == {"/scan": 1}
    assert summary["notes"] == ["of the test"]


class Picky(Output):
    """Takes nothing."""

    def publish(self, update):
        raise InputError("no such time")

    def close(self):
        pass


def test_scans_that_cannot_be_used_do_not_end_the_run():
    """Neither the first one of a stream, nor one whose time an output cannot tell."""
    one_ray = LaserScan(0, np.ones(1, np.float32), 0.0, 0.1, 0.1, 20.0, topic="/scan")
    items = [(None, record(LASER, one_ray)), (None, record(LASER, laser(1)))]
    pipeline = CirclesLive(CirclesConfig(), n_scanners=1)
    poses = LivePoses(PoseOptions(pose="static"), LiveConfig())
    loop = LiveLoop(Played(*items), lambda sort: pipeline, poses, [Picky("paper")], LiveConfig())
    loop.run(PATIENCE_S)
    first, second = loop.summary()["rejected"]
    assert first.startswith("/scan: its scans cannot be used: ")
    assert second == "paper: no such time"


def test_two_scanners_are_both_known_before_the_first_scan_is_taken():
    pipeline = CirclesLive(CirclesConfig(), n_scanners=2)
    assert not pipeline.is_ready(laser(0))
    posed = lc.io.PosedScan(laser(0), np.eye(4))
    assert pipeline.take(posed, "world") == "scans of other LiDARs are missing"
    rear = LaserScan(0, np.full(20, 3.0, np.float32), -1, 0.1, 0.1, 20, topic="/rear")
    assert pipeline.is_ready(rear)
    assert not isinstance(pipeline.take(posed, "world"), str)
    with pytest.raises(ConfigError, match=r"scanner\.n_beams: the recording states this value"):
        CirclesLive(CirclesConfig(scanner={"n_beams": 7}), n_scanners=1)


# Names and messages


@pytest.mark.parametrize("topic", ["/scan", "/robot/front/scan"])
def test_keys_of_rmw_zenoh_there_and_back(topic):
    key = key_of(topic, "sensor_msgs/msg/LaserScan", "RIHS01_00", domain=7)
    assert key.startswith("7/")
    assert topic_of(key) == (topic, "sensor_msgs/msg/LaserScan")


@pytest.mark.parametrize("key", ["tf", "robot/scan", "0/scan/x", "a/b/c/d"])
def test_other_keys_are_no_topics_of_rmw_zenoh(key):
    assert topic_of(key) is None


def test_the_key_of_a_string_is_that_of_rmw_zenohs_own_example():
    type_hash = ros_store(2).hash_rihs01("std_msgs/msg/String")
    assert key_of("/chatter", "std_msgs/msg/String", type_hash, domain=0) == (
        "0/chatter/std_msgs::msg::dds_::String_/"
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_objects_become_detections_and_odometry():
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])[None]
    covariance[0, 0, 1] = covariance[0, 1, 0] = 0.5
    objects = lc.viz.Objects(
        id=np.array([7]),
        position=np.array([[1.0, 2, 3]]),
        velocity=np.array([[4.0, 5, 6]]),
        covariance=covariance[:, :3, :3],
        size=np.array([[0.1, 0.2, 0.3]]),
    )
    messages = RosMessages(2)
    make = ObstacleArrays(messages, frame_id="map", name="flying")
    raw = messages.packed(make.message(DETECTIONS_TYPE, 1_000_000_005, objects))
    found = messages.store.deserialize_cdr(raw, DETECTIONS_TYPE)
    assert (found.header.frame_id, found.header.stamp.nanosec) == ("map", 5)
    (detection,) = found.detections
    (result,) = detection.results
    assert (detection.id, result.hypothesis.class_id) == ("7", "flying")
    assert detection.bbox.size.z == 0.3
    assert result.pose.covariance.reshape(6, 6)[0, 1] == 0.5
    (odometry,) = make.odometry(0, objects, covariance)
    assert odometry.child_frame_id == "track_7"
    assert odometry.twist.twist.linear.z == 6.0
    assert odometry.twist.covariance.reshape(6, 6)[2, 2] == 6.0
    assert odometry.pose.pose.position.y == 2.0


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "street.npz"
    few = ["--sensor", "os1-32", "--scans", "12"]
    done = CliRunner().invoke(app, ["simulate", "demo", "-o", str(path), *few])
    assert done.exit_code == 0, done.output
    return path


def test_walls_of_the_map_go_to_viewers():
    """A wall 5 m ahead of a scanner that stands."""
    pipeline, scanner = CirclesLive(CirclesConfig(), n_scanners=1), lc.circles.Scanner()
    bearings = scanner.bearings()
    ranges = np.full(len(bearings), np.inf, np.float32)
    ahead = np.abs(bearings) < 0.6
    ranges[ahead] = 5 / np.cos(bearings[ahead])
    limits = (scanner.angle_min, scanner.angle_increment, 0.1, 10.0)
    for number in range(15):
        scan = LaserScan(number * 50_000_000, ranges, *limits)
        assert pipeline.is_ready(scan)
        update = pipeline.take(lc.io.PosedScan(scan, np.eye(4)), "world")
    shapes, outlines = update.frame.map_shapes, update.moment().outlines
    assert [one.id for one in outlines] == shapes.id.tolist() != []
    np.testing.assert_array_equal(outlines[0].points[:, :2], shapes.ends[0])
    assert outlines[0].points[:, 0] == pytest.approx(5, abs=0.01)
    assert outlines[0].visible == shapes.visible[0]


def test_flying_objects_go_to_viewers_by_class_and_with_numbers(street, tmp_path):
    pipeline = FlyingLive(FlyingObjectDetector())
    outputs = [McapOutput(tmp_path / "a.mcap")]
    if find_spec("rerun") is not None:
        outputs.append(RerunOutput(tmp_path / "a.rrd"))
    with lc.io.open_recording(street) as recording:
        for item in lc.io.posed_scans(recording):
            assert pipeline.is_ready(item.scan)
            update = pipeline.take(item, "world")
            for output in outputs:
                output.publish(update)
    for output in outputs:
        output.close()
    moment = update.moment()
    assert len(moment.objects.id) == 2
    assert update.covariance.shape == (2, 6, 6)
    assert set(np.unique(moment.point_class)) <= {1, 2, 3}
    assert np.quantile(moment.points[:, 2], 0.05) == pytest.approx(0.0, abs=0.15)
    flying = moment.points[moment.point_class == PointClass.FLYING]
    away = np.linalg.norm(flying[:, None] - moment.objects.position[None], axis=2).min(axis=1)
    assert np.median(away) < 0.5
    with lc.io.open_recording(tmp_path / "a.mcap") as recording:
        counts = {topic.name: topic.count for topic in recording.topics()}
    assert counts["/classes"] == counts["/tracks"] == 12
    if len(outputs) == 2:
        done = subprocess.run(
            [sys.executable, "-m", "rerun", "rrd", "verify", tmp_path / "a.rrd"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert "without error" in done.stdout + done.stderr


# Other processes


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


@pytest.fixture(scope="module")
def circles(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "circles.npz"
    done = CliRunner().invoke(app, ["simulate", "circles", "-o", str(path), "--scans", str(SCANS)])
    assert done.exit_code == 0, done.output
    return path


@contextmanager
def live(*arguments):
    """`lidar-core live` in a process of its own."""
    command = [sys.executable, "-c", MAIN, "live", "--json", "-", *map(str, arguments)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_line(process, text):
    for line in process.stderr:
        if text in line:
            return line
    raise AssertionError(f"ended with {process.wait()} before saying {text!r}")


def interrupted(process, by=signal.SIGINT):
    """The summary after Ctrl-C."""
    process.send_signal(by)
    out, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    return json.loads(out)


def wait_until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


class Robot:
    """A recording as a robot would publish it, its times shifted to now."""

    def __init__(self, path):
        with lc.io.open_recording(path) as recording:
            self.items = list(recording)
        self.messages = RosMessages(2)
        self.first_ns = min(item.stamp_ns for item in self.items if item.stamp_ns)

    def play(self, send, *, rate=0.5):
        """Call `send` with every message in time."""
        begin_ns = time.time_ns()
        for item in self.items:
            due_ns = begin_ns + round((item.stamp_ns - self.first_ns) / rate)
            time.sleep(max(due_ns - time.time_ns(), 0) * 1e-9)
            send(replace(item, stamp_ns=due_ns))

    def packed(self, item):
        """Topic, type and bytes of a message of ROS 2."""
        topic, message = self.messages.of(item)
        return topic, message.__msgtype__, self.messages.packed(message)


@contextmanager
def zenoh_peer(port):
    """A session that others link to."""
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()


class Listener:
    """Decodes what `lidar-core live` publishes."""

    def __init__(self, session, key, type_name):
        self.got, self.attachments = [], []
        self._type, self._store = type_name, ros_store(2)
        self._subscriber = session.declare_subscriber(key, self._take)

    def _take(self, sample):
        self.got.append(self._store.deserialize_cdr(sample.payload.to_bytes(), self._type))
        self.attachments.append(sample.attachment.to_bytes())


def zenoh_key(robot, topic, type_name, naming):
    if naming == "bridge":
        return topic.strip("/")
    type_hash = robot.messages.store.hash_rihs01(type_name)
    return key_of(topic, type_name, type_hash, domain=3)


@pytest.mark.ci_cases("rmw")
@pytest.mark.parametrize("naming", ["rmw", "bridge"])
def test_a_robot_on_zenoh_gets_tracks_of_its_own_scans(circles, naming):
    robot, port = Robot(circles), free_port()
    place = f"zenoh:tcp/127.0.0.1:{port}"
    named = ["--scan", "/laser/scan"] if naming == "bridge" else []
    with zenoh_peer(port) as session:
        begin = "lidar_core" if naming == "bridge" else "3/lidar_core"
        tracks = Listener(session, f"{begin}/tracks/**", DETECTIONS_TYPE)
        odometry = Listener(session, f"{begin}/odometry/**", "nav_msgs/msg/Odometry")
        tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**")]
        assert tokens == []
        with live("--in", place, "--out", place, "--domain", 3, *named) as process:
            wait_for_line(process, "scans/s")
            tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**")]
            assert {token.split("/")[5] for token in tokens} == {"NN", "MP"}

            def send(item):
                topic, type_name, raw = robot.packed(item)
                session.put(zenoh_key(robot, topic, type_name, naming), raw)

            session.put(zenoh_key(robot, "/laser/scan", "sensor_msgs/msg/LaserScan", naming), b"x")
            wait_for_line(process, "scans/s")  # before a newer message takes its place
            wait_for_line(process, "scans/s")
            robot.play(send)
            wait_until(lambda: len(tracks.got) > SCANS // 8)
            time.sleep(0.5)
            summary = interrupted(process)
            wait_until(lambda: len(tracks.got) >= summary["processed"])
            targets = sum(len(found.detections) for found in tracks.got)
            wait_until(lambda: len(odometry.got) >= targets)
    assert summary["capability"] == "circles"
    assert summary["processed"] == len(tracks.got) > SCANS // 8
    assert summary["processed"] + sum(summary["dropped"].values()) >= SCANS - 2
    assert summary["bad_messages"] == {"/laser/scan": 1}
    assert summary["latency_ms"]["from_arrival"]["median"] > 0
    last = tracks.got[-1]
    assert last.header.frame_id == "world"
    assert len({item.id for item in last.detections}) == len(last.detections) >= 3
    assert {len(item) for item in tracks.attachments} == {33}
    children = Counter(item.child_frame_id for item in odometry.got)
    expected = Counter(f"track_{item.id}" for found in tracks.got for item in found.detections)
    assert children == expected


@pytest.mark.nightly
def test_the_robot_of_the_examples_is_processed(circles):
    pytest.importorskip("zenoh")
    address = f"tcp/127.0.0.1:{free_port()}"
    robot = subprocess.Popen([sys.executable, ROBOT, str(circles), "0.5", address])
    with live("--in", f"zenoh:{address}") as process:
        wait_until(lambda: robot.poll() is not None)
        summary = interrupted(process)
    assert robot.returncode == 0
    assert summary["processed"] > SCANS // 8
    assert summary["processed"] + sum(summary["dropped"].values()) > SCANS // 2


@pytest.mark.parametrize(("given", "status"), [(["--help"], 0), ([], 1)])
def test_the_robot_of_the_examples_says_what_it_takes(given, status):
    pytest.importorskip("zenoh")
    command = [sys.executable, ROBOT, *given]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == status
    assert "robot_on_zenoh.py RECORDING [RATE] [ADDRESS]" in done.stdout + done.stderr


def test_the_robot_of_the_examples_ends_with_a_recording_that_breaks(circles, monkeypatch):
    pytest.importorskip("zenoh")

    def broken(*_):
        raise FormatError("of the test")

    publisher_of = runpy.run_path(str(ROBOT))["Publisher"]
    replay = ReplaySource(circles, ReadOptions(), rate=1.0, topics=StreamTopics())
    monkeypatch.setattr(replay, "_in_turn", broken)
    publisher = publisher_of(replay, lambda key, raw: None)
    replay.start(publisher)
    assert publisher.ended.wait(PATIENCE_S)
    replay.close()
    assert str(publisher.error) == "of the test"


def test_named_topics_of_zenoh_may_have_any_type_of_their_sort():
    pytest.importorskip("zenoh")
    topics = StreamTopics(scans=("/front",), odometry="/pose")
    source = ZenohSource("tcp/there", topics, ReadOptions(), LiveConfig(transform_topics=()))
    keys = [key for key, _ in source._keys()]
    found = [topic_of(key) for key in keys if topic_of(key) is not None]
    assert found[:5] == [
        ("/front", "sensor_msgs/msg/LaserScan"),
        ("/front", "sensor_msgs/msg/MultiEchoLaserScan"),
        ("/pose", "nav_msgs/msg/Odometry"),
        ("/pose", "geometry_msgs/msg/PoseStamped"),
        ("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
    ]
    assert [key for key in keys if topic_of(key) is None] == ["front", "pose"]


def test_what_was_published_once_before_reaches_those_who_come_later(circles):
    """Static transforms are kept by their publishers, for who asks."""
    ext = pytest.importorskip("zenoh.ext")
    robot, port = Robot(circles), free_port()
    messages = robot.messages
    with zenoh_peer(port) as session:
        _, tf = messages.of(pose(0, 0.0, "base", "laser", is_static=True))
        key = key_of("/tf_static", tf.__msgtype__, "RIHS01_00", domain=0)
        keeper = ext.declare_advanced_publisher(
            session, key, cache=ext.CacheConfig(max_samples=1), publisher_detection=True
        )
        keeper.put(messages.packed(tf))
        with live("--in", f"zenoh:tcp/127.0.0.1:{port}", "--odom", "/odom") as process:
            wait_for_line(process, "scans/s")
            ended = Event()

            def publish():
                while not ended.wait(0.05):
                    now = time.time_ns()
                    odometry = pose(now, 0.0, "odom", "base", covariance=np.eye(6))
                    for item in (odometry, laser(now)):
                        topic, type_name, raw = robot.packed(item)
                        session.put(key_of(topic, type_name, "RIHS01_00", domain=0), raw)

            publishing = Thread(target=publish)
            publishing.start()
            try:
                wait_until(lambda: " 0.0 scans/s" not in wait_for_line(process, "scans/s"))
            finally:
                ended.set()
                publishing.join()
            summary = interrupted(process)
    assert summary["frame_id"] == "odom", summary
    assert summary["processed"] > 0


@pytest.mark.nightly
def test_nobody_on_zenoh_is_an_error_with_its_cure(monkeypatch):
    pytest.importorskip("zenoh")
    with live("--in", f"zenoh:tcp/127.0.0.1:{free_port()}") as process:
        out, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert out == ""
    assert "start the router of rmw_zenoh (ros2 run rmw_zenoh_cpp rmw_zenohd)" in errors


@pytest.mark.nightly
def test_a_broker_that_comes_back_is_linked_again(circles):
    robot, port = Robot(circles), free_port()
    scans = [item for item in robot.items if isinstance(item, LaserScan)][:10]

    def send_all(session):
        for scan in scans:
            topic, type_name, raw = robot.packed(replace(scan, stamp_ns=time.time_ns()))
            session.put(key_of(topic, type_name, "RIHS01_00", domain=0), raw)
            time.sleep(0.05)

    with live("--in", f"zenoh:tcp/127.0.0.1:{port}", "--pose", "static") as process:
        with zenoh_peer(port) as session:
            wait_for_line(process, "scans/s")
            send_all(session)
        wait_for_line(process, f"no link to tcp/127.0.0.1:{port}, trying again")
        with zenoh_peer(port) as session:
            wait_until(lambda: "no link" not in wait_for_line(process, "scans/s"))
            send_all(session)
            summary = interrupted(process)
    assert summary["processed"] + sum(summary["dropped"].values()) > len(scans)


@contextmanager
def foxglove_server(port):
    foxglove = pytest.importorskip("foxglove")
    context = foxglove.Context()
    server = foxglove.start_server(host="127.0.0.1", port=port, context=context)
    try:
        yield context
    finally:
        server.stop()


def test_foxglove_in_and_foxglove_out(circles):
    """One server plays a robot; what `live` serves is read by its own client."""
    robot, port, out = Robot(circles), free_port(), free_port()
    with live("--in", f"foxglove:ws://127.0.0.1:{port}", "--out", f"foxglove:{out}") as process:
        with foxglove_server(port) as context:
            log = FoxgloveLog(context, tracks_frame="world")
            log.write(robot.items[0])
            time.sleep(1.0)
            inbox = Inbox(max_poses=1000)
            viewer = FoxgloveSource(
                f"ws://127.0.0.1:{out}", StreamTopics(), ReadOptions(), LiveConfig()
            )
            viewer.start(inbox)
            robot.play(log.write)
            wait_until(lambda: viewer.trouble() == "")
            robot.play(log.write)
            wait_until(lambda: inbox.dropped.total() > 5)
            poses, scans = [], []
            end = time.monotonic() + PATIENCE_S
            while not (poses and scans):  # channels are subscribed one by one
                assert time.monotonic() < end
                robot.play(log.write)
                batch = inbox.take(1.0)
                poses.extend(batch.poses)
                scans.extend(batch.scans)
            viewer.close()
        wait_for_line(process, f"no server at ws://127.0.0.1:{port}, trying again")
        summary = interrupted(process)
    assert summary["capability"] == "circles"
    assert summary["processed"] > 5
    (scan,) = scans[-1].record.decode()
    assert isinstance(scan, LaserScan)
    assert np.isfinite(scan.ranges).any()
    (transform,) = poses[-1].record.decode()
    assert (transform.frame_id, transform.child_frame_id) == ("world", "laser")


def ended(process):
    """Exit status and what was said, of a command that ends by itself."""
    out, errors = process.communicate(timeout=PATIENCE_S)
    return process.returncode, json.loads(out), errors


def test_a_topic_that_foxglove_does_not_have_is_told_within_three_seconds():
    """What is advertised instead is listed, once; the status is 3 where nothing ever came."""
    port = free_port()
    with foxglove_server(port) as context:
        log = FoxgloveLog(context, tracks_frame="world")
        log.write(laser(0))
        log.write(pose(0))
        place = f"foxglove:ws://127.0.0.1:{port}"
        with live("--in", place, "--scan", "/nope", "--seconds", 5) as process:
            wait_for_line(process, "from foxglove")
            begun = time.monotonic()
            told = wait_for_line(process, "no scan yet of /nope")
            assert time.monotonic() - begun < 3
            status, summary, errors = ended(process)
    assert told.endswith("has: /scan (foxglove.LaserScan); /tf (foxglove.FrameTransform)\n"), told
    assert "no scan yet" not in errors
    assert status == 3
    assert summary["processed"] == 0


@pytest.mark.nightly
@pytest.mark.parametrize("naming", ["rmw", "bridge", "graph"])
def test_a_topic_that_zenoh_does_not_have_is_told_within_three_seconds(circles, naming):
    """By the messages that come, or by the tokens of the ROS graph where none come."""
    robot, port, over = Robot(circles), free_port(), Event()
    scan = next(item for item in robot.items if isinstance(item, LaserScan))
    topic, type_name, raw = robot.packed(scan)
    key = zenoh_key(robot, topic, type_name, naming)

    with zenoh_peer(port) as session:

        def publish():
            while not over.wait(0.1):
                session.put(key, raw)

        publishing = Thread(target=publish)
        graph = "MP/%/%/node/%laser%scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_0/::,:,:,,"
        if naming == "graph":
            token = session.liveliness().declare_token(f"@ros2_lv/3/{session.zid()}/0/1/{graph}")
            over.set()
        publishing.start()
        place = f"zenoh:tcp/127.0.0.1:{port}"
        with live("--in", place, "--scan", "/nope", "--seconds", 5) as process:
            wait_for_line(process, "from zenoh")
            begun = time.monotonic()
            told = wait_for_line(process, "no scan yet of /nope")
            assert time.monotonic() - begun < 3
            status, _, _ = ended(process)
        over.set()
        publishing.join()
        if naming == "graph":
            token.undeclare()
    there = {
        "rmw": "/laser/scan (sensor_msgs/msg/LaserScan), domain 3",
        "bridge": "/laser/scan (no type in its key)",
        "graph": "/laser/scan (sensor_msgs/msg/LaserScan), domain 3",
    }
    assert told.endswith(f"has: {there[naming]}\n"), told
    assert status == 3


def test_a_stream_of_which_nothing_ever_came_ends_with_status_three_after_ctrl_c():
    port = free_udp_port()
    with live("--in", f"velodyne:{port}", "--pose", "static") as process:
        told = wait_for_line(process, "no scan yet")
        process.send_signal(signal.SIGINT)
        status, summary, _ = ended(process)
    assert (status, summary["processed"]) == (3, 0)
    assert told == (
        f"no scan yet: no packet came to port {port}; check the destination address and port that"
        " are set in the sensor, and the firewall of this machine\n"
    )


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


def test_scans_that_cannot_be_read_are_something_that_came():
    items = [(None, Record(LASER, 0, lambda: []))]
    loop = LiveLoop(
        Played(*items),
        lambda sort: Slow(0),
        LivePoses(PoseOptions(), LiveConfig()),
        [],
        LiveConfig(),
        topics=["/scan"],
    )
    assert loop.heard_nothing
    loop.run()
    assert not loop.heard_nothing


@pytest.mark.parametrize(
    ("way_ms", "told"),
    [
        (1795373951730, "clocks differ by 20779.8 days"),
        (-90_000, "clocks differ by 90.0 s"),
        (-400_000, "clocks differ by 6.7 min"),
        (4 * 3_600_000, "clocks differ by 4.0 h"),
        (-50, "clocks differ by 50 ms"),
        (9_000, None),
        (0, None),
    ],
)
def test_latencies_of_clocks_that_differ_say_so(way_ms, told):
    """Otherwise the line would hold a latency of weeks, or a negative one."""
    stats = LiveStats()
    for _ in range(3):
        stats.from_arrival.add(5_000_000)
        stats.from_stamp.add(5_000_000 + way_ms * 1_000_000)
    summary = stats.summary()
    assert (summary["latency_ms"]["from_stamp"] is None) == (told is not None)
    report = Report(1.0, 3.0, stats.from_stamp.recent(), stats.from_arrival.recent(), {}, 0, 0, "")
    if told is None:
        assert summary["clocks_differ_ms"] is None
        assert _since_stamp(report).endswith(" ms")
    else:
        assert summary["clocks_differ_ms"] == pytest.approx(way_ms)
        assert _since_stamp(report) == told


@pytest.mark.nightly
def test_the_console_says_that_clocks_differ(circles):
    """Stamps of 1970, as of a robot without a clock."""
    robot, port = Robot(circles), free_port()
    scans = [item for item in robot.items if isinstance(item, LaserScan)][:10]
    place = f"zenoh:tcp/127.0.0.1:{port}"
    with zenoh_peer(port) as session, live("--in", place, "--pose", "static") as process:
        wait_for_line(process, "scans/s")
        for number, scan in enumerate(scans):
            topic, type_name, raw = robot.packed(replace(scan, stamp_ns=number * 10**8))
            session.put(key_of(topic, type_name, "RIHS01_00", domain=0), raw)
            time.sleep(0.1)
        line = wait_for_line(process, "clocks differ by")
        assert re.search(r"from stamp clocks differ by \d{5}\.\d days", line)
        summary = interrupted(process)
    assert summary["latency_ms"]["from_stamp"] is None
    assert summary["clocks_differ_ms"] > 1e12
    assert summary["latency_ms"]["from_arrival"]["median"] < 1e4


def test_no_foxglove_server_is_an_error_with_its_cure(monkeypatch):
    monkeypatch.setattr("lidar_core.live.sources.foxglove.CONNECT_TIMEOUT", 0.2)
    inbox = Inbox(max_poses=1)
    place = f"ws://127.0.0.1:{free_port()}"
    pytest.importorskip("websockets")
    source = FoxgloveSource(place, StreamTopics(), ReadOptions(), LiveConfig())
    source.start(inbox)
    with pytest.raises(LinkError, match="start foxglove_bridge on the robot"):
        inbox.take(PATIENCE_S)
    assert "no server" in source.trouble()
    source.close()


def test_what_went_wrong_after_connecting_is_told(monkeypatch):
    pytest.importorskip("websockets")
    port = free_port()
    with foxglove_server(port):
        place, inbox = f"ws://127.0.0.1:{port}", Inbox(max_poses=1)
        source = FoxgloveSource(place, StreamTopics(), ReadOptions(), LiveConfig())

        def broken(link, inbox):
            raise OSError("of the test")

        monkeypatch.setattr(source, "_listen", broken)
        source.start(inbox)
        wait_until(lambda: source.findings.notes)
        wait_until(lambda: source.trouble() != "")
        told = source.trouble()
        source.close()
    assert told == f"no server at {place}, trying again (OSError: of the test)"
    assert source.findings.notes == [f"{place}: OSError: of the test"]


def test_messages_that_are_none_do_not_end_a_stream():
    pytest.importorskip("websockets")
    source = FoxgloveSource("ws://there", StreamTopics(), ReadOptions(), LiveConfig())
    inbox, sent = Inbox(max_poses=10), []

    class Link:
        def send(self, text):
            sent.append(json.loads(text))

    channel = {"id": 4, "topic": "/scan", "encoding": "cdr", "schemaName": "sensor_msgs/LaserScan"}
    image = {**channel, "id": 5, "topic": "/image", "schemaName": "sensor_msgs/msg/Image"}
    for message in ([], {"op": "status"}, {"op": "advertise"}):
        source._converse(message, Link())
    source._converse({"op": "advertise", "channels": [channel, image]}, Link())
    assert sent == [{"op": "subscribe", "subscriptions": [{"id": 4, "channelId": 4}]}]
    nameless = {"id": 6, "topic": "/other", "encoding": "cdr"}
    for channels in (None, 7, [nameless, "none", {**channel, "id": "seven"}, {**channel, "id": 8}]):
        source._converse({"op": "advertise", "channels": channels}, Link())
    assert sent[1:] == [{"op": "subscribe", "subscriptions": [{"id": 8, "channelId": 8}]}]
    assert source._read("{") is None
    assert source.findings.rejected == {"ws://there": 4}
    assert source.findings.notes[0] == "ws://there, channel /other: KeyError: 'schemaName'"
    head = (4).to_bytes(4, "little") + bytes(8)
    for data in (b"", b"\x01", b"\x02" + head, b"\x01" + bytes(12), b"\x01" + head + b"rubbish"):
        source._take(data, inbox)
    assert inbox.rejected.total() == 2
    (arrival,) = inbox.take(0).scans
    with pytest.raises(FormatError, match="ws://there, /scan"):
        arrival.record.decode()


def test_channels_that_a_server_takes_back_are_forgotten():
    pytest.importorskip("websockets")
    source = FoxgloveSource("ws://there", StreamTopics(), ReadOptions(), LiveConfig())
    inbox, link = Inbox(max_poses=10), SimpleNamespace(send=lambda text: None)
    channel = {"id": 4, "topic": "/scan", "encoding": "cdr", "schemaName": "sensor_msgs/LaserScan"}
    source._converse({"op": "advertise", "channels": [channel]}, link)
    for numbers in (None, ["four", 5, None], ["4"]):
        source._take(b"\x01" + (4).to_bytes(4, "little") + bytes(8), inbox)
        assert len(inbox.take(0).scans) == 1
        source._converse({"op": "unadvertise", "channelIds": numbers}, link)
    source._take(b"\x01" + (4).to_bytes(4, "little") + bytes(8), inbox)
    assert inbox.take(0).scans == []


def laser_channel(number, topic):
    return {"id": number, "topic": topic, "encoding": "cdr", "schemaName": "sensor_msgs/LaserScan"}


@contextmanager
def refusing_server(channels, knows):
    """As foxglove-sdk and older servers: tells of `channels`, refuses what `knows` is false for and
    whoever asks twice. Yields its port and the numbers it was asked for."""
    websockets = pytest.importorskip("websockets.sync.server")
    asked = []

    def tell(link, text):
        link.send(json.dumps({"op": "status", "level": 2, "message": text}))

    def serve(link):
        link.send(json.dumps({"op": "advertise", "channels": channels}))
        known = set()
        for text in link:
            asked.append([pair["channelId"] for pair in json.loads(text)["subscriptions"]])
            tell(link, "Unknown service: 7")
            for number in asked[-1]:
                if number in known:
                    tell(link, f"Client subscription id {number} was already used")
                elif not knows(number, len(asked)):
                    tell(link, f"Unknown channel ID: {number}")
                else:
                    known.add(number)
                    if number != QUIET:
                        link.send(b"\x01" + number.to_bytes(4, "little") + bytes(8))

    with websockets.serve(serve, "127.0.0.1", 0, subprotocols=["foxglove.sdk.v1"]) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.socket.getsockname()[1], asked
        server.shutdown()


QUIET = 3


def test_channels_that_a_server_tells_of_too_early_are_subscribed_again(monkeypatch):
    monkeypatch.setattr("lidar_core.live.sources.foxglove.RETRY_INTERVAL", 0.05)
    channels = [
        laser_channel(1, "/known"),
        laser_channel(2, "/new"),
        laser_channel(QUIET, "/quiet"),
    ]
    with refusing_server(channels, lambda number, times: number != 2 or times == 3) as served:
        port, asked = served
        inbox = Inbox(max_poses=1)
        source = FoxgloveSource(
            f"ws://127.0.0.1:{port}", StreamTopics(), ReadOptions(), LiveConfig()
        )
        source.start(inbox)
        wait_until(lambda: len(inbox._scans) == 2)
        time.sleep(0.3)
        source.close()
    assert asked == [[1, 2, 3], [2], [2]]
    assert source.findings.notes == []


def test_a_channel_that_stays_unknown_is_given_up(monkeypatch):
    monkeypatch.setattr("lidar_core.live.sources.foxglove.RETRY_INTERVAL", 0.01)
    with refusing_server([laser_channel(4, "/none")], lambda number, times: False) as (port, asked):
        place, inbox = f"ws://127.0.0.1:{port}", Inbox(max_poses=1)
        source = FoxgloveSource(place, StreamTopics(), ReadOptions(), LiveConfig())
        source.start(inbox)
        wait_until(lambda: source.findings.notes)
        time.sleep(0.3)
        source.close()
    assert asked == [[4]] * 10
    told = f"{place}, channel /none: the server announced it, but does not accept a subscription"
    assert source.findings.notes == [told]


def test_schemas_are_told_apart_by_what_they_say(monkeypatch):
    pytest.importorskip("websockets")
    monkeypatch.setattr("lidar_core.live.sources.foxglove.MAX_CHANNELS", 2)
    source = FoxgloveSource("ws://there", StreamTopics(), ReadOptions(), LiveConfig())
    link = SimpleNamespace(send=lambda text: None)
    for number in range(100):
        source._converse({"op": "advertise", "channels": [laser_channel(number, "/scan")]}, link)
        source._converse({"op": "unadvertise", "channelIds": [number]}, link)
    assert len(source._schemas) == 1
    for kind in ("Odometry", "Path"):
        channel = {**laser_channel(7, "/odom"), "schemaName": f"nav_msgs/{kind}"}
        source._converse({"op": "advertise", "channels": [channel]}, link)
    assert source.findings.notes == ["ws://there, channel /odom: ValueError: more than 2 schemas"]


def test_a_replay_is_processed_and_leaves_whole_files(circles, tmp_path):
    file = tmp_path / "out.mcap"
    done = CliRunner().invoke(
        app,
        [
            "live",
            "--replay",
            str(circles),
            "--rate",
            "0.5",
            "--out",
            f"mcap:{file}",
            "--json",
            str(tmp_path / "live.json"),
        ],
    )
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "live.json").read_text())
    assert summary["processed"] + sum(summary["dropped"].values()) == SCANS
    assert summary["frame_id"] == "world"
    with lc.io.open_recording(file) as recording:
        counts = {topic.name: topic.count for topic in recording.topics()}
    assert counts["/circles"] == summary["processed"]
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_replay_gives_scans_with_their_last_ray(circles):
    """As drivers do, so that a latency is none of waiting for the poses of a sweep."""

    class Noted(Inbox):
        def put(self, record):
            noted.append((time.time_ns(), record))

    noted = []
    source = ReplaySource(circles, ReadOptions(), rate=4.0, topics=StreamTopics())
    inbox = Noted(max_poses=1)
    source.start(inbox)
    assert inbox.take(PATIENCE_S).is_finished
    source.close()
    times, late_ms = [], []
    for time_ns, item in noted:
        (message,) = item.decode()
        is_scan = isinstance(message, LaserScan)
        end_ns = span_ns(message)[1] if is_scan else message.stamp_ns
        assert not is_scan or end_ns > message.stamp_ns
        times.append(end_ns)
        late_ms.append((time_ns - end_ns - source.lead_ns(end_ns)) * 1e-6)
    moving = [end for end in times if end]
    assert moving == sorted(moving)
    assert min(late_ms) >= -0.001
    assert sum(isinstance(item.decode()[0], LaserScan) for _, item in noted) == SCANS


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_end_a_replay_with_whole_files(circles, tmp_path, by):
    file = tmp_path / "out.mcap"
    with live("--replay", circles, "--rate", 0.05, "--out", f"mcap:{file}") as process:
        wait_for_line(process, "scans/s")
        wait_for_line(process, "scans/s")
        summary = interrupted(process, by)
    assert 0 < summary["processed"] < SCANS
    with lc.io.open_recording(file) as recording:
        assert {topic.name: topic.count for topic in recording.topics()}["/circles"] == (
            summary["processed"]
        )


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (
            ["--scan", "/b"],
            ConfigError,
            r"scan: no topic '/b' with 2D scans in .*; found \(no topic\)$",
        ),
        (["--cloud", "/b"], ConfigError, "cloud: no topic '/b' with clouds in .*; found none$"),
        (
            ["--capability", "flying"],
            FormatError,
            r"no clouds to read; found \(no topic\) \(npz laser\), .*"
            r"; 2D scans are for --capability circles$",
        ),
        (["--map", "a.pcd"], FormatError, r"no clouds to read; found \(no topic\) \(npz"),
    ],
)
def test_a_replay_without_what_is_wanted_is_refused(circles, arguments, error, text):
    refused = CliRunner().invoke(app, ["live", "--replay", str(circles), *arguments])
    assert isinstance(refused.exception, error)
    assert re.search(text, str(refused.exception))


def test_an_error_of_the_function_names_the_argument_capability(circles, street):
    with pytest.raises(FormatError, match=r'; 2D scans are for capability="circles"$'):
        lc.runs.live(None, None, None, replay=circles, capability="flying")
    with pytest.raises(FormatError, match=r'; clouds are for capability="flying"$'):
        lc.runs.live(None, None, None, replay=street, capability="circles")


@pytest.mark.parametrize("out", ["mcap:{}", "rerun:{}.rrd"])
def test_files_are_replaced_only_where_that_was_asked_for(circles, tmp_path, out):
    out = out.format(tmp_path / "old")
    file = Path(out.partition(":")[2])
    file.write_text("kept")
    arguments = ["live", "--replay", str(circles), "--seconds", "0", "--out", out]
    refused = CliRunner().invoke(app, arguments)
    assert isinstance(refused.exception, ConfigError)
    assert str(refused.exception) == f"{file}: exists; --overwrite replaces it"
    assert file.read_text() == "kept"
    if out.startswith("mcap") or find_spec("rerun") is not None:
        done = CliRunner().invoke(app, [*arguments, "--overwrite"])
        assert done.exit_code == 0, done.output
        assert file.read_text() == "kept"  # no scan, no file
        done = CliRunner().invoke(app, [*arguments[:3], "--overwrite", "--rate", "5", "--out", out])
        assert done.exit_code == 0, done.output
        assert file.read_bytes() != b"kept"
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_a_replay_never_replaces_what_it_plays(circles, tmp_path):
    played = tmp_path / "a.mcap"
    assert CliRunner().invoke(app, ["convert", str(circles), str(played)]).exit_code == 0
    before = played.read_bytes()
    refused = CliRunner().invoke(
        app, ["live", "--replay", str(played), "--out", f"mcap:{tmp_path}/./a.mcap", "--overwrite"]
    )
    assert isinstance(refused.exception, ConfigError)
    assert "is also the input; choose another file to write" in str(refused.exception)
    assert played.read_bytes() == before


def same_tables(left, right, name):
    """Columns of a table of two runs."""
    columns = [read_columns(next(folder.glob(f"{name}.*"))) for folder in (left, right)]
    assert list(columns[0]) == list(columns[1])
    for column in columns[0]:
        np.testing.assert_array_equal(columns[0][column], columns[1][column], err_msg=column)


def live_run(path, folder):
    """The folder of a live run that dropped no scan; the summary."""
    with lc.io.open_recording(path) as recording:
        scans = [item for item in recording if isinstance(item, Scan | LaserScan)]
    topic = Topic("", "", "scan" if isinstance(scans[0], Scan) else "planar")
    source = Played(*((None, record(topic, scan)) for scan in scans))
    chosen = PipelineChoice("auto", (), (), None, None, 2)
    kept = LiveFolder(RunFolder(folder, overwrite=False), chosen.pipeline)
    poses, config = PoseOptions(pose="static"), LiveConfig(max_waiting=1000)
    loop = LiveLoop(source, kept.pipeline, LivePoses(poses, config), [kept], config)
    loop.run()
    told = {"live": config, "read": ReadOptions(), "pose": poses}
    summary, files, _ = kept.write(loop.summary(), told, {"recording": path, "map": None})
    return {**summary, "files": files}


@pytest.mark.ci_cases("circles")
@pytest.mark.parametrize("capability", ["circles", "flying"])
def test_a_live_run_leaves_the_folder_of_a_run(circles, street, tmp_path, capability):
    recording = circles if capability == "circles" else street
    folders = tmp_path / "live", tmp_path / "run"
    told = live_run(recording, folders[0])
    command = "circles" if capability == "circles" else "detect"
    done = CliRunner().invoke(
        app, [command, str(recording), "-o", str(folders[1]), "--pose", "static"]
    )
    assert done.exit_code == 0, done.output
    names = [{path.name for path in folder.iterdir()} for folder in folders]
    assert names[0] == names[1] == set(told["files"])
    of_all = json.loads((folders[1] / "summary.json").read_text())
    assert told["scans"] == of_all["scans"]
    for table in ("circles", "shapes") if capability == "circles" else ("tracks",):
        same_tables(*folders, table)
    same_tables(*folders, "detections")
    notes = [tomllib.loads((folder / "run.toml").read_text()) for folder in folders]
    assert notes[0]["config"][capability] == notes[1]["config"][capability]
    assert notes[0]["config"]["live"]["max_waiting"] == 1000
    assert notes[0]["input"]["recording"] == notes[1]["input"]["recording"]
    assert lc.viz.Playback(folders[0]).capability == capability


def test_a_live_run_ends_with_a_whole_folder(circles, tmp_path):
    folder = tmp_path / "run"
    with live("--replay", circles, "--rate", 0.05, "-o", folder) as process:
        wait_for_line(process, "scans/s")
        summary = interrupted(process, signal.SIGTERM)
    assert 0 < summary["processed"] < SCANS
    assert len(read_columns(next(folder.glob("timing.*")))["t_ns"]) == summary["processed"]
    assert not [path for path in folder.rglob("*") if path.name.startswith(".")]


def test_a_folder_of_a_live_run_is_checked_first(circles, tmp_path):
    folder = tmp_path / "run"
    arguments = ["live", "--replay", str(circles), "-o", str(folder)]
    nothing = CliRunner().invoke(app, [*arguments, "--seconds", "0"])
    assert nothing.exit_code == 0, nothing.output
    assert not folder.exists()
    folder.mkdir()
    (folder / "letter.txt").write_text("kept")
    refused = CliRunner().invoke(app, arguments)
    assert isinstance(refused.exception, FileExistsError)
    twice = CliRunner().invoke(app, [*arguments, "--out", f"mcap:{folder}/run.mcap"])
    assert isinstance(twice.exception, ConfigError)
    assert str(twice.exception) == (
        f"--out mcap:{folder}/run.mcap: the run writes this file into {folder} anyway;"
        " leave this output out"
    )


def test_a_run_without_its_mcap_keeps_its_tables(circles, tmp_path, monkeypatch):
    folder = tmp_path / "run"

    def full(self, *, keep=True):
        raise OSError(f"{folder}/run.mcap: cannot be written: disk full")

    monkeypatch.setattr(lc.io.McapWriter, "close", full)
    done = CliRunner().invoke(
        app, ["live", "--replay", str(circles), "--rate", "50", "-o", str(folder)]
    )
    assert isinstance(done.exception, OSError)
    assert "run.mcap: cannot be written" in str(done.exception)
    told = json.loads((folder / "summary.json").read_text())
    assert told["scans"]["processed"] > 0
    assert len(read_columns(next(folder.glob("timing.*")))["t_ns"]) == told["scans"]["processed"]
    assert (folder / "run.toml").exists()
    assert str(folder) in done.stdout


def test_two_outputs_to_one_file_are_refused(circles, tmp_path):
    named = ["--out", f"mcap:{tmp_path}/a.mcap", "--out", f"mcap:{tmp_path}/./a.mcap"]
    refused = CliRunner().invoke(app, ["live", "--replay", str(circles), *named])
    assert isinstance(refused.exception, ConfigError)
    assert str(refused.exception) == (
        f"--out {tmp_path}/a.mcap: expected once, it is given 2 times"
    )


@pytest.mark.parametrize("out", ["mcap:{}/nowhere/a.mcap", "rerun:{}/nowhere/a.rrd"])
def test_a_missing_folder_is_named_before_the_first_scan(circles, tmp_path, out):
    if out.startswith("rerun"):
        pytest.importorskip("rerun")
    refused = CliRunner().invoke(
        app, ["live", "--replay", str(circles), "--out", out.format(tmp_path)]
    )
    assert isinstance(refused.exception, FileNotFoundError)
    assert str(refused.exception).startswith(f"{tmp_path / 'nowhere'}: no such folder, to write a.")


def test_a_port_in_use_is_an_error_with_its_cure(circles):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        refused = CliRunner().invoke(
            app, ["live", "--replay", str(circles), "--out", f"foxglove:{port}"]
        )
    assert isinstance(refused.exception, LinkError)
    text = f"foxglove: port {port} cannot be opened .*; stop the program that uses it, or choose"
    assert re.search(f"{text} another port: foxglove:[0-9]+$", str(refused.exception))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "--in, --replay: expected one of them"),
        (["--in", "zenoh", "--replay", "a.bag"], "--in, --replay: expected one of them"),
        (["--in", "mqtt"], r"--in mqtt: expected one of zenoh\["),
        (["--in", "udp:2368"], r"--in udp:2368: expected one of zenoh.* velodyne\[:PORT\],"),
        (["--in", "hesai:2368"], "one of zenoh.*; of this sensor run the driver, and listen to"),
        (
            ["--in", "ouster", "--pose", "kiss"],
            "--in ouster: expected ouster:HOST or ouster:FILE.json",
        ),
        (["--in", "livox:0"], "carry no poses; add --pose static .* or --pose kiss for poses"),
        (
            ["--in", "velodyne:0", "--pose", "static", "--metrics", "a:b"],
            "metrics: expected a port",
        ),
        (["--in", "velodyne:0", "--rate", "2"], "--rate: does not apply to a stream"),
        (
            ["--in", "velodyne:nowhere", "--pose", "static"],
            "--in velodyne: expected a port from 0 to 65535, got 'nowhere'",
        ),
        (
            ["--in", "velodyne:0", "--pose", "static", "--out", "paper"],
            r"--out paper: expected one of foxglove\[",
        ),
        (
            ["--in", "velodyne:0", "--pose", "static", "--out", "mcap"],
            "--out mcap: expected one of",
        ),
        (
            ["--in", "velodyne:0", "--pose", "static", "--out", "rerun:web:x"],
            "--out rerun:web: expected a port",
        ),
        (
            ["--in", "velodyne:0", "--allow-origin", "*"],
            "allow-origin: expected the scheme and the",
        ),
        (
            ["--in", "velodyne:0", "--pose", "a.txt"],
            "expected auto, static or kiss for a live stream",
        ),
        (["--in", "velodyne:0", "--cloud", "/a", "--scan", "/b"], "expected topics of one kind"),
        (
            ["--in", "velodyne:0", "--scan", "/b", "--capability", "flying"],
            "flying does not read /b",
        ),
        (
            ["--in", "velodyne:0", "--map", "a.pcd", "--scan", "/b"],
            "map: applies only to flying objec",
        ),
        (
            ["--in", "velodyne:0", "--map", "a.pcd", "--capability", "circles"],
            "map: applies only to f",
        ),
        (["--in", "foxglove:http://a"], "expected an address such as ws://.*, got 'http://a'"),
        (
            ["--in", "velodyne:0", "--stream", "bogus=1"],
            "--stream bogus: .*; known names: pose_wait, max_",
        ),
        (
            ["--in", "velodyne:0", "--stream", "bogus"],
            "--stream bogus: expected name=value, such as pose",
        ),
        (["--in", "velodyne:0", "--stream", "domain=999"], "--stream domain: .* 232"),
        (["--in", "velodyne:0", "--domain", "999"], "^domain: .* 232"),
    ],
)
def test_options_that_make_no_sense_are_refused_in_words(arguments, text):
    refused = CliRunner().invoke(app, ["live", *arguments])
    assert isinstance(refused.exception, ConfigError)
    assert re.search(text, str(refused.exception))


def test_reruns_window_without_a_display_is_refused(monkeypatch):
    from lidar_core.live.outputs import output

    def refuse(*_):
        raise AssertionError("nothing may be started")

    monkeypatch.setattr(output, "has_display", lambda: False)
    monkeypatch.setattr(output, "rerun_process", refuse)
    with pytest.raises(
        ConfigError, match=r"no display here: expected rerun:web or rerun:FILE\.rrd"
    ):
        output.RerunWindowOutput()


def rerun_window(monkeypatch, *, log=lambda moment: None, close=lambda: None):
    """Make the output of rerun's window with a viewer whose log has these functions."""
    from lidar_core.live.outputs import output

    window = SimpleNamespace(poll=lambda: None)
    stream = SimpleNamespace(connect_grpc=lambda address: None)
    made = SimpleNamespace(stream=stream, begin=lambda: None, log=log, close=close)
    monkeypatch.setattr(output, "has_display", lambda: True)
    monkeypatch.setattr(output, "rerun_process", lambda arguments: nullcontext(window))
    monkeypatch.setattr(output, "_new_log", lambda: made)
    return output.RerunWindowOutput(), window


def test_nothing_is_sent_to_a_window_of_rerun_that_was_closed(monkeypatch):
    sent = []
    shown, window = rerun_window(monkeypatch, log=sent.append, close=lambda: sent.append("close"))
    shown.publish(SimpleNamespace(moment=lambda: "first"))
    until = time.monotonic() + PATIENCE_S
    while not sent and time.monotonic() < until:
        time.sleep(0.01)
    window.poll = lambda: 0
    shown.publish(SimpleNamespace(moment=lambda: "second"))
    shown.close()
    assert sent == ["first"]


def test_scans_do_not_wait_for_a_window_that_takes_nothing(monkeypatch):
    from lidar_core.live.outputs.output import WINDOW_BACKLOG

    sent, takes = [], Event()

    def log(moment):
        assert takes.wait(PATIENCE_S)
        sent.append(moment)

    shown, _ = rerun_window(monkeypatch, log=log)
    for number in range(100):
        shown.publish(SimpleNamespace(moment=lambda number=number: number))
    assert not sent
    takes.set()
    shown.close()
    # The newest, and perhaps the first, with which the window has begun; the end took one place.
    assert sent[-WINDOW_BACKLOG + 1 :] == list(range(101 - WINDOW_BACKLOG, 100))
    assert len(sent) <= WINDOW_BACKLOG


def test_what_fails_in_the_window_is_raised_once_with_the_next_scan(monkeypatch):
    sent = []

    def log(moment):
        if moment == "first":
            raise ValueError("no such colour")
        sent.append(moment)

    shown, _ = rerun_window(monkeypatch, log=log)
    shown.publish(SimpleNamespace(moment=lambda: "first"))
    until = time.monotonic() + PATIENCE_S
    while shown._error is None and time.monotonic() < until:
        time.sleep(0.01)
    with pytest.raises(ValueError, match="no such colour"):
        shown.publish(SimpleNamespace(moment=lambda: "second"))
    shown.publish(SimpleNamespace(moment=lambda: "third"))
    shown.close()
    assert sent == ["second", "third"]


MUTE_VIEWER = """#!{python}
import pathlib, signal, socket, sys, time
if "analytics" not in sys.argv:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    port = int(sys.argv[sys.argv.index("--port") + 1])
    with socket.create_server(("127.0.0.1", port)):
        pathlib.Path({ready!r}).touch()
        time.sleep(600)
"""
"""A viewer that takes no data, does not answer, and does not end when it is asked to."""


@pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk is not installed")
@pytest.mark.skipif(os.name != "posix", reason="the viewer is a script")
def test_a_viewer_that_does_not_answer_is_killed(monkeypatch, tmp_path):
    from lidar_core.live.outputs import output
    from lidar_core.viz import rerun_process

    script, ready, ports = tmp_path / "viewer", tmp_path / "ready", []
    script.write_text(MUTE_VIEWER.format(python=sys.executable, ready=str(ready)))
    script.chmod(0o755)
    free_port = output.free_port
    monkeypatch.setenv("RERUN_CLI_PATH", str(script))
    monkeypatch.setattr(output, "has_display", lambda: True)
    monkeypatch.setattr(output, "free_port", lambda: ports.append(free_port()) or ports[0])
    for module in (output, rerun_process):
        monkeypatch.setattr(module, "PATIENCE_S", 0.5)
    shown = output.RerunWindowOutput()
    until = time.monotonic() + PATIENCE_S
    while not ready.exists() and time.monotonic() < until:
        time.sleep(0.05)
    closing = Thread(target=shown.close, daemon=True)
    closing.start()
    closing.join(PATIENCE_S)
    assert not closing.is_alive()
    until = time.monotonic() + PATIENCE_S
    while listens(*ports):  # a process that was killed may end a moment later
        assert time.monotonic() < until
        time.sleep(0.05)


def listens(port):
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except ConnectionError:
        return False
    return True


def test_a_window_of_rerun_that_is_closed_at_the_end_is_no_error(monkeypatch):
    def flush():
        raise RuntimeError("gRPC connection severed")

    rerun_window(monkeypatch, close=flush)[0].close()
