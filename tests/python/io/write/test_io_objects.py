"""Objects of a run for other programs, read again by the reference readers."""

import json
from uuid import UUID

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

from lidar_core import ConfigError, InputError
from lidar_core.cli import app
from lidar_core.flying import FlyingObjectDetector
from lidar_core.io import write_mot, write_nuscenes, write_ros_objects
from lidar_core.io.messages.ros_types import (
    COSTMAP_TYPES,
    DETECTIONS_TYPE,
    DYNAMIC_TYPE,
    OBSTACLES_TYPE,
)
from lidar_core.io.tables import circles, shapes, tracks
from lidar_core.io.write.ros_obstacles import TOPICS
from lidar_core.runs.scans.flying_output import FlyingRun
from lidar_core.viz import Objects, Playback

BASE_NS = 1_700_000_000_000_000_000
FRAMES = [[3, 8], [], [8]]
NUSCENES_BOX = {
    "sample_token": str,
    "translation": list,
    "size": list,
    "rotation": list,
    "velocity": list,
    "tracking_id": str,
    "tracking_name": str,
    "tracking_score": float,
}
"""Fields of a box of nuScenes' tracking challenge."""


def objects(numbers, *, are_circles=False):
    rng = np.random.default_rng(4000 + sum(numbers))
    root = rng.normal(size=(len(numbers), 3, 3))
    size = rng.uniform(0.2, 2.0, (len(numbers), 3))
    if are_circles:
        size[:, 1], size[:, 2] = size[:, 0], 0.0
    return Objects(
        id=np.array(numbers, np.int64),
        position=rng.normal(size=(len(numbers), 3)) * 10,
        velocity=rng.normal(size=(len(numbers), 3)),
        covariance=root @ root.transpose(0, 2, 1),
        size=size,
    )


@pytest.fixture(params=[False, True], ids=["boxes", "circles"])
def steps(request):
    return [
        (BASE_NS + k * 10**8, objects(numbers, are_circles=request.param))
        for k, numbers in enumerate(FRAMES)
    ]


def test_nuscenes_results_have_a_sample_per_time_and_all_fields(tmp_path, steps):
    path = tmp_path / "r.json"
    write_nuscenes(path, steps, name="pedestrian", sensors=("lidar", "radar"))
    read = json.loads(path.read_text())
    assert read["meta"] == {
        "use_camera": False,
        "use_lidar": True,
        "use_radar": True,
        "use_map": False,
        "use_external": False,
    }
    assert list(read["results"]) == [str(stamp) for stamp, _ in steps]
    for stamp, found in steps:
        boxes = read["results"][str(stamp)]
        assert [int(box["tracking_id"]) for box in boxes] == found.id.tolist()
        for row, box in enumerate(boxes):
            assert {name: type(value) for name, value in box.items()} == NUSCENES_BOX
            assert box["sample_token"] == str(stamp)
            assert box["translation"] == found.position[row].tolist()
            length, width, height = found.size[row].tolist()
            assert box["size"] == [width, length, height]
            assert box["rotation"] == [1, 0, 0, 0]  # w first
            assert box["velocity"] == found.velocity[row, :2].tolist()
            assert (box["tracking_name"], box["tracking_score"]) == ("pedestrian", 1.0)


def test_trackeval_reads_the_mot_file(tmp_path, steps):
    base = pytest.importorskip("trackeval.datasets._base_dataset")
    path = tmp_path / "r.txt"
    write_mot(path, steps)
    read, _ = base._BaseDataset._load_simple_text_file(str(path))
    assert sorted(map(int, read)) == [1, 3]
    for frame, (_, found) in enumerate(steps, start=1):
        rows = np.array(read.get(str(frame), np.empty((0, 10))), float)
        assert rows.shape == (len(found.id), 10)
        np.testing.assert_array_equal(rows[:, 1], found.id)
        np.testing.assert_array_equal(rows[:, 2:7], np.tile([-1, -1, -1, -1, 1], (len(rows), 1)))
        np.testing.assert_allclose(rows[:, 7:], found.position, atol=5.1e-7)


def read_messages(path):
    """Messages by type, as rosbags reads them by the definitions in the file."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    found = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.msgtype, []).append((connection.topic, time_ns, message))
    return found


def xyz(value):
    return [value.x, value.y, value.z]


def check_header(header, stamp):
    assert header.frame_id == "map"
    assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp


@pytest.mark.parametrize("name", ["r.bag", "r"])
def test_every_ros_message_comes_back(tmp_path, steps, name):
    rng = np.random.default_rng(4100)
    walls = {steps[0][0]: rng.normal(size=(2, 2, 3)), steps[2][0]: rng.normal(size=(1, 2, 3))}
    topics = write_ros_objects(
        tmp_path / name, steps, frame_id="map", name="person", segments=walls
    )
    version = 1 if name == "r.bag" else 2
    read = read_messages(tmp_path / name)
    types = {OBSTACLES_TYPE, DETECTIONS_TYPE, COSTMAP_TYPES[version]}
    assert set(read) == types | ({DYNAMIC_TYPE} if version == 2 else set())
    assert {topic for rows in read.values() for topic, _, _ in rows} == set(topics)
    for rows in read.values():
        assert [time_ns for _, time_ns, _ in rows] == [stamp for stamp, _ in steps]
        for (stamp, _), (_, _, message) in zip(steps, rows, strict=True):
            check_header(message.header, stamp)
    for number, (stamp, found) in enumerate(steps):
        check_detections(read[DETECTIONS_TYPE][number][2], found, version)
        check_obstacles(read[OBSTACLES_TYPE][number][2], found, walls.get(stamp, []))
        check_costmap(read[COSTMAP_TYPES[version]][number][2], found)
        if version == 2:
            check_dynamic(read[DYNAMIC_TYPE][number][2], found)


def check_detections(message, found, version):
    assert len(message.detections) == len(found.id)
    for row, one in enumerate(message.detections):
        (result,) = one.results
        if version == 2:
            assert (one.id, result.hypothesis.class_id) == (str(found.id[row]), "person")
            assert result.hypothesis.score == 1
        else:
            assert (result.id, result.score, one.source_cloud.width) == (found.id[row], 1, 0)
        for pose in (one.bbox.center, result.pose.pose):
            assert xyz(pose.position) == found.position[row].tolist()
            assert pose.orientation.w == 1
        assert xyz(one.bbox.size) == found.size[row].tolist()
        covariance = np.reshape(result.pose.covariance, (6, 6))
        np.testing.assert_array_equal(covariance[:3, :3], found.covariance[row])
        assert not covariance[3:].any()


def check_obstacles(message, found, walls):
    ends = [[xyz(one.first_point), xyz(one.last_point)] for one in message.segments]
    assert ends == [wall.tolist() for wall in walls]
    assert [xyz(one.center) for one in message.circles] == found.position.tolist()
    assert [xyz(one.velocity) for one in message.circles] == found.velocity.tolist()
    widest = (found.size[:, :2].max(axis=1) / 2).tolist()
    assert [one.radius for one in message.circles] == widest
    assert [one.true_radius for one in message.circles] == widest


def check_costmap(message, found):
    assert [one.id for one in message.obstacles] == found.id.tolist()
    for row, one in enumerate(message.obstacles):
        assert xyz(one.velocities.twist.linear) == found.velocity[row].tolist()
        corners = np.array([[point.x, point.y] for point in one.polygon.points])
        np.testing.assert_allclose(corners.mean(axis=0), found.position[row, :2], rtol=1e-5)
        if found.size[row, 2] == 0:
            assert (len(corners), one.radius) == (1, found.size[row, 0] / 2)
        else:
            assert (len(corners), one.radius) == (4, 0)
            np.testing.assert_allclose(np.ptp(corners, axis=0), found.size[row, :2], rtol=1e-4)


def check_dynamic(message, found):
    assert [UUID(bytes=bytes(one.uuid.uuid)).int for one in message.obstacles] == found.id.tolist()
    assert [xyz(one.position) for one in message.obstacles] == found.position.tolist()
    assert [xyz(one.velocity) for one in message.obstacles] == found.velocity.tolist()
    assert [xyz(one.size) for one in message.obstacles] == found.size.tolist()
    assert all(one.score == 1 for one in message.obstacles)


def test_a_time_that_ros_cannot_tell_is_refused_and_leaves_nothing(tmp_path):
    pytest.importorskip("rosbags")
    with pytest.raises(InputError, match="stamp_ns: ROS 1 holds times from 1970"):
        write_ros_objects(tmp_path / "r.bag", [(-1, objects([1]))], frame_id="map", name="x")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def run(tmp_path):
    """A run of three scans, in the second of which nothing was found."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.toml").write_text("")
    (folder / "detections.csv").write_text("t_ns\n")
    (folder / "timing.csv").write_text("t_ns,total_ms\n100,1\n200,1\n300,1\n")
    (folder / "tracks.csv").write_text(
        "t_ns,track_id,frame_id,x,y,z,vx,vy,vz,extent_x,extent_y,extent_z\n"
        "100,7,odom,1,2,3,4,5,6,1,2,3\n300,7,odom,2,3,4,4,5,6,1,2,3\n"
    )
    return folder


def test_the_times_without_objects_are_there(run):
    played = Playback(run)
    assert [(stamp, found.id.tolist()) for stamp, found in played.steps()] == [
        (100, [7]),
        (200, []),
        (300, [7]),
    ]
    assert played.frame_id == "odom"


@pytest.mark.parametrize("name", ["r.json", "r.txt", "r.bag", "r"])
def test_convert_takes_a_run(run, tmp_path, name):
    pytest.importorskip("rosbags")
    out = CliRunner().invoke(
        app, ["convert", str(run), str(tmp_path / name), "--class", "drone", "--json", "-"]
    )
    assert out.exit_code == 0, out.output
    told = json.loads(out.stdout)
    assert (told["times"], told["states"], told["objects"]) == (3, 2, 1)
    if name == "r.json":
        read = json.loads((tmp_path / name).read_text())
        assert read["results"]["100"][0]["tracking_name"] == "drone"
        assert read["results"]["200"] == []
    elif name == "r.txt":
        lines = (tmp_path / name).read_text().splitlines()
        assert [line.split(",")[:2] for line in lines] == [["1", "7"], ["3", "7"]]
    else:
        (_, time_ns, message), *_ = read_messages(tmp_path / name)[OBSTACLES_TYPE]
        assert (time_ns, message.header.frame_id) == (100, "odom")


def test_walls_of_a_map_of_circles_become_segments(tmp_path):
    """A wall, a square of side 2 around (10, 0), an ellipse, which is none."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.toml").write_text("")
    (folder / "timing.csv").write_text("t_ns,total_ms\n100,1\n200,1\n")
    (folder / "circles.csv").write_text("t_ns,track_id,frame_id,x,y,vx,vy,radius\n")
    names = ["t_ns", "track_id", "kind", *shapes.STATE, *shapes.ENDS, "visible"]
    rows = [
        [100, 1, "line", 3, 0, 0, 0, 0, 1, 0, 3, -1, 3, 1, 1],
        [100, 2, "rectangle", 10, 0, 0, 0, 0, 1, 1, "nan", "nan", "nan", "nan", 1],
        [100, 3, "ellipse", 5, 5, 0, 0, 0, 1, 2, "nan", "nan", "nan", "nan", 0],
    ]
    lines = [",".join(map(str, row)) for row in (names, *rows)]
    (folder / "shapes.csv").write_text("\n".join(lines) + "\n")
    done = CliRunner().invoke(app, ["convert", str(folder), str(tmp_path / "r.bag")])
    assert done.exit_code == 0, done.output
    first, second = (row[2] for row in read_messages(tmp_path / "r.bag")[OBSTACLES_TYPE])
    ends = np.array([[xyz(one.first_point), xyz(one.last_point)] for one in first.segments])
    np.testing.assert_allclose(ends[0], [[3, -1, 0], [3, 1, 0]])
    assert len(ends) == 5
    np.testing.assert_allclose(np.linalg.norm(ends[1:, 1] - ends[1:, 0], axis=1), 2)
    np.testing.assert_allclose(ends[1:].mean(axis=(0, 1)), [10, 0, 0])
    assert len(second.segments) == 0


@pytest.mark.parametrize(
    "option", ["--topic", "--start", "--end", "--point-time", "--metadata", "--resolution"]
)
def test_options_that_say_nothing_about_a_run_are_refused(run, tmp_path, option):
    out = CliRunner().invoke(app, ["convert", str(run), str(tmp_path / "r.json"), option, "1"])
    assert isinstance(out.exception, ConfigError)
    assert str(out.exception) == f"{option}: does not apply to the objects of a run"
    assert not (tmp_path / "r.json").exists()


def test_sizes_that_nobody_knows_are_zero_for_others_and_seen_in_viewers(run, tmp_path):
    table = run / "tracks.csv"
    table.write_text(table.read_text().replace(",1,2,3\n", ",0,0,0\n"))
    CliRunner().invoke(app, ["convert", str(run), str(tmp_path / "r.json")])
    read = json.loads((tmp_path / "r.json").read_text())
    assert read["results"]["100"][0]["size"] == [0, 0, 0]
    moment = next(iter(Playback(run).moments()))
    np.testing.assert_array_equal(moment.objects.size, [[0.1, 0.1, 0.1]])


def test_a_flat_box_is_no_circle(tmp_path):
    pytest.importorskip("rosbags")
    flat = objects([1, 2])
    flat.size[:] = [[2.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    write_ros_objects(tmp_path / "r.bag", [(BASE_NS, flat)], frame_id="map", name="x")
    ((_, _, message),) = read_messages(tmp_path / "r.bag")[COSTMAP_TYPES[1]]
    assert [len(one.polygon.points) for one in message.obstacles] == [4, 1]
    assert [one.radius for one in message.obstacles] == [0, 0]


def test_an_ending_that_a_run_cannot_become_is_refused(run, tmp_path):
    out = CliRunner().invoke(app, ["convert", str(run), str(tmp_path / "r.pcd")])
    assert isinstance(out.exception, ConfigError)
    refusal = str(out.exception)
    assert "r.pcd: unknown suffix '.pcd'; formats for a run: " in refusal
    assert ".txt (MOTChallenge)" in refusal
    assert ".json (nuScenes)" in refusal


def test_the_guide_names_every_column():
    text = (ROOT / "docs/formats.md").read_text(encoding="utf-8")
    detections = FlyingRun(FlyingObjectDetector()).detections_table()
    for columns in (tracks.COLUMNS, circles.COLUMNS, shapes.COLUMNS, detections):
        named = [name for name in columns if not name.startswith("cov_")]
        assert [name for name in named if f"`{name}`" not in text] == []
    assert [name for name in NUSCENES_BOX if f"`{name}`" not in text] == []
    for kind, topic in TOPICS.items():
        assert f"`{kind.replace('/msg/', '/')}`" in text
        assert f"`{topic}`" in text
