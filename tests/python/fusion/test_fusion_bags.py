"""ROS recordings of radar tracks, positions, poses and turn rates, fused."""

import json

import numpy as np
import pytest
from ros_files import Ros
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError
from lidar_core.fusion import BagOptions, read_bag
from lidar_core.io.messages.ros_types import ros_store
from lidar_core.io.rotations import quaternion_from_angles

SEED = 9600
FLOAT32 = 1e-6  # what radar messages hold, relative
EXACT = 1e-12
STEP_NS = 50_000_000
UUID = {1: "uuid_msgs/msg/UniqueID", 2: "unique_identifier_msgs/msg/UUID"}
STORAGES = [(1, "bag"), (2, "sqlite3"), (2, "mcap")]


class Radar(Ros):
    """Makes messages of targets and of the platform."""

    def __init__(self, version):
        super().__init__(version)
        self.store = ros_store(version)
        self.types = self.store.types

    def vector(self, values, kind="Vector3"):
        return self.types[f"geometry_msgs/msg/{kind}"](*map(float, [*values, 0.0][:3]))

    def tracks(self, stamp_ns, targets, variances=(0.0, 0.0)):
        """RadarTracks from (x, y, vx, vy)."""
        made = []
        for x, y, vx, vy in targets:
            upper = [np.array([v, 0, 0, v, 0, 0], np.float32) for v in (*variances, 0.0, 0.0)]
            made.append(
                self.types["radar_msgs/msg/RadarTrack"](
                    self.types[UUID[self.version]](np.zeros(16, np.uint8)),
                    self.vector([x, y], "Point"),
                    self.vector([vx, vy]),
                    self.vector([0, 0]),
                    self.vector([1, 1]),
                    0,
                    *upper,
                )
            )
        return self.types["radar_msgs/msg/RadarTracks"](self.header(stamp_ns, "radar"), made)

    def scan(self, stamp_ns, returns):
        """RadarScan from (range, azimuth, elevation, doppler)."""
        made = [self.types["radar_msgs/msg/RadarReturn"](*map(float, one), 1.0) for one in returns]
        return self.types["radar_msgs/msg/RadarScan"](self.header(stamp_ns, "radar"), made)

    def point(self, stamp_ns, place):
        header = self.header(stamp_ns, "lidar")
        return self.types["geometry_msgs/msg/PointStamped"](header, self.vector(place, "Point"))

    def pose(self, stamp_ns, place, yaw=0.0):
        turn = self.types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)
        )
        inner = self.types["geometry_msgs/msg/Pose"](self.vector(place, "Point"), turn)
        return self.types["geometry_msgs/msg/PoseStamped"](self.header(stamp_ns, "map"), inner)

    def moving(self, stamp_ns, place, yaw, velocity, rate):
        """Odometry with a twist in the axes of the platform."""
        turn = [0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]
        message = self.odometry(stamp_ns, "odom", "base", [*place, 0.0, *turn])
        message.twist.twist.linear = self.vector(velocity)
        message.twist.twist.angular = self.vector([0.0, 0.0, rate])
        return message

    def imu(self, stamp_ns, rates, angles=None):
        make = self.types
        q = (0.0, 0.0, 0.0, 1.0) if angles is None else quaternion_from_angles(*angles)
        unknown = np.zeros(9)
        unknown[0] = -1.0 if angles is None else 0.0
        return make["sensor_msgs/msg/Imu"](
            self.header(stamp_ns, "imu"),
            make["geometry_msgs/msg/Quaternion"](*map(float, q)),
            unknown,
            self.vector(rates),
            np.diag([1e-4, 1e-4, 4e-4]).reshape(-1),
            make["geometry_msgs/msg/Vector3"](0.0, 0.0, 9.8),
            np.zeros(9),
        )


def stored(folder, version, storage, messages):
    path = folder / ("run.bag" if storage == "bag" else "run")
    return Radar(version).write(path, messages, storage)


def fused(*arguments):
    out = CliRunner().invoke(app, ["fuse", *map(str, arguments), "--json", "-"])
    assert out.exit_code == 0, out.output or out.exception
    return json.loads(out.stdout)


def passing(ros, count=80, *, targets=1):
    """Targets that pass a platform which drives and turns: truth in the world at the end."""
    rng = np.random.default_rng(SEED)
    messages = []
    start, speed = (
        np.array([[10.0, 3.0], [14.0, -6.0]])[:targets],
        np.array([[-0.5, 0.4], [0, 0.8]]),
    )
    for k in range(count):
        stamp, t = k * STEP_NS, k * STEP_NS * 1e-9
        yaw, at = 0.2 * t, np.array([0.3 * t, 0.1 * t])
        back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        ground = np.array([0.3, 0.1])
        messages.append(("/odom", stamp, ros.moving(stamp, at, yaw, back @ ground, 0.2)))
        places = start + speed[:targets] * t
        seen = (places - at) @ back.T + rng.normal(0, 0.1, places.shape)
        if k % 2:
            moving = (speed[:targets] - ground) @ back.T
            messages.append(("/radar", stamp, ros.tracks(stamp, np.hstack([seen, moving]))))
        else:
            messages += [("/lidar", stamp, ros.point(stamp, place)) for place in seen[:1]]
    return messages, places


@pytest.mark.parametrize(("version", "storage"), STORAGES)
def test_every_type_gives_its_measurement(version, storage, tmp_path):
    ros = Radar(version)
    path = stored(
        tmp_path,
        version,
        storage,
        [
            ("/tracks", 1, ros.tracks(1, [(3, 4, 1, 2), (6, -8, 0, 1)], (0.04, 0.09))),
            ("/scan", 2, ros.scan(2, [(10, 0.5, 0.3, -2), (5, -0.2, 0, 1)])),
            ("/lidar", 3, ros.point(3, (1.5, -2.5))),
            ("/odom", 4, ros.moving(4, (1, 2), np.pi / 2, (3, 0), 0.25)),
            ("/imu", 5, ros.imu(5, (0.1, 0.2, 0.3), (0.2, -0.1, 0.7))),
            ("/imu", 6, ros.imu(6, (0.1, 0.2, 0.3))),
        ],
    )
    scans = read_bag(path)
    assert [scan.stamp_ns for scan in scans] == [1, 2, 3, 4, 5, 6]
    assert [scan.source for scan in scans[:3]] == ["/tracks", "/scan", "/lidar"]
    first, second = scans[0].measurements
    np.testing.assert_allclose(first.values, [5, np.arctan2(4, 3), 2.2], rtol=EXACT)
    np.testing.assert_allclose(second.values, [10, np.arctan2(-8, 6), -0.8], rtol=EXACT)
    across = (np.array([1, 2]) - 2.2 * np.array([3, 4]) / 5) / 5
    variances = [0.04, 0.04 / 25, 0.09 + 0.04 * across @ across]
    np.testing.assert_allclose(np.diag(first.covariance), variances, rtol=FLOAT32)
    np.testing.assert_allclose(
        scans[1].measurements[0].values, [10 * np.cos(0.3), 0.5, -2 / np.cos(0.3)], rtol=FLOAT32
    )
    assert scans[2].measurements[0].values.tolist() == [1.5, -2.5]
    (pose,) = scans[3].measurements
    np.testing.assert_allclose(pose.values, [1, 2, np.pi / 2, 0, 3, 0.25], atol=EXACT)
    (turning,), (level,) = scans[4].measurements, scans[5].measurements
    expected = (0.2 * np.sin(0.2) + 0.3 * np.cos(0.2)) / np.cos(0.1)
    assert turning.values[0] == pytest.approx(expected, rel=1e-9)
    assert level.values[0] == pytest.approx(0.3)
    assert level.covariance.tolist() == [[4e-4]]


def test_a_radar_that_counts_approaching_targets_is_turned_round(tmp_path):
    path = stored(tmp_path, 2, "mcap", [("/r", 1, Radar(2).scan(1, [(10, 0, 0, 3)]))])
    (scan,) = read_bag(path, BagOptions(doppler="approaching"))
    assert scan.measurements[0].values[2] == -3


@pytest.mark.parametrize(("version", "storage"), STORAGES)
def test_one_target_is_followed_in_the_world(version, storage, tmp_path):
    messages, places = passing(Radar(version))
    path = stored(tmp_path, version, storage, messages)
    result = fused(path, "-o", tmp_path / "out", "--no-picture")
    assert result["format"] == "ROS"
    assert result["measurements"] == {"pose": 80, "lidar": 40, "radar": 40}
    last = (tmp_path / "out" / "tracks_tum" / "track_0.txt").read_text().splitlines()[-1].split()
    np.testing.assert_allclose([float(last[1]), float(last[2])], places[0], atol=0.3)


def test_several_targets_are_tracked_in_the_world(tmp_path):
    messages, places = passing(Radar(2), targets=2)
    path = stored(tmp_path, 2, "mcap", messages)
    result = fused(path, "-o", tmp_path / "out", "--association", "joint")
    assert (result["tracks"], result["association"]) == (2, "joint")
    assert set(result["scans"]) == {"/lidar", "/odom", "/radar"}
    assert set(result["nis"]) == {"/lidar", "/radar"}
    ends = [
        (tmp_path / "out" / "tracks_tum" / f"track_{n}.txt").read_text().splitlines()[-1]
        for n in (0, 1)
    ]
    found = np.array([[float(value) for value in line.split()[1:3]] for line in ends])
    apart = np.linalg.norm(found[:, None] - places, axis=2)
    assert apart.min(axis=1).max() < 0.4


def test_topics_are_chosen_by_name(tmp_path):
    ros = Radar(2)
    path = stored(
        tmp_path,
        2,
        "mcap",
        [
            ("/ours", 1, ros.pose(1, (1, 2), 0.5)),
            ("/target", 1, ros.pose(1, (7, 8))),
            ("/far", 1, ros.point(1, (3, 4))),
            ("/near", 2, ros.point(2, (5, 6))),
        ],
    )
    with pytest.raises(ConfigError, match=r"several hold poses, /ours, /target"):
        read_bag(path)
    scans = read_bag(path, BagOptions(topics={"pose": ("/ours",), "lidar": ("/target", "/near")}))
    found = {scan.source: scan.measurements[0] for scan in scans}
    assert set(found) == {"/ours", "/target", "/near"}
    assert found["/target"].sensor == "lidar"
    np.testing.assert_allclose(found["/ours"].values, [1, 2, 0.5], atol=EXACT)
    result = fused(path, "-o", tmp_path / "out", "--topic", "pose=/ours", "--topic", "lidar=/far")
    assert result["measurements"] == {"pose": 1, "lidar": 1}


@pytest.mark.parametrize(
    ("topics", "text"),
    [
        ({"radar": ("/none",)}, "'/none' is not there"),
        ({"radar": ("/far",)}, "PointStamped"),
        ({"sonar": ("/far",)}, "topics"),
    ],
)
def test_wrong_topics_are_told(topics, text, tmp_path):
    path = stored(tmp_path, 2, "mcap", [("/far", 1, Radar(2).point(1, (3, 4)))])
    with pytest.raises(ConfigError, match=text):
        read_bag(path, BagOptions.load({"topics": topics}))


def test_a_recording_without_measurements_is_refused(tmp_path):
    ros = Radar(2)
    path = stored(tmp_path, 2, "mcap", [("/tf", 1, ros.transforms([]))])
    with pytest.raises(FormatError, match=r"no measurements in it; topics: /tf") as refused:
        read_bag(path)
    for readable in ("lidar: geometry_msgs/PointStamped", "radar_msgs/RadarTracks", "nav_msgs/Od"):
        assert readable in str(refused.value)


def test_info_shows_what_can_be_fused(tmp_path):
    messages, _ = passing(Radar(2), count=10)
    path = stored(tmp_path, 2, "mcap", messages)
    out = CliRunner().invoke(app, ["info", str(path), "--json"])
    topics = {topic["name"]: topic["kind"] for topic in json.loads(out.stdout)["topics"]}
    assert topics == {"/lidar": "measurement", "/odom": "pose", "/radar": "measurement"}
    assert json.loads(out.stdout)["defects"] == ["no scans; measurements are for `lidar-core fuse`"]


def mounted(ros, child, angles, parent="base"):
    """A static transform that turns a sensor on the platform."""
    values = [0.5, 0.1, 0.0, *quaternion_from_angles(*angles)]
    return ros.transforms([(0, parent, child, values)])


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_sensors_see_in_the_axes_of_the_platform(storage, tmp_path):
    ros = Radar(2)
    left, over = (0.0, 0.0, np.pi / 2), (np.pi, 0.0, 0.0)  # roll, pitch, yaw
    path = stored(
        tmp_path,
        2,
        storage,
        [
            ("/tf_static", 0, mounted(ros, "radar", left)),
            ("/tf_static", 0, mounted(ros, "lidar", over)),
            ("/tf_static", 0, mounted(ros, "imu", over)),
            ("/odom", 1, ros.moving(1, (1, 2), 0.0, (3, 0), 0.25)),
            ("/tracks", 2, ros.tracks(2, [(3, 4, 1, 2)], (0.04, 0.09))),
            ("/scan", 3, ros.scan(3, [(10, 0.5, 0.3, -2)])),
            ("/lidar", 4, ros.point(4, (1.5, -2.5))),
            ("/imu", 5, ros.imu(5, (0.1, 0.2, 0.3))),
        ],
    )
    _, track, echo, point, turning = [scan.measurements[0] for scan in read_bag(path)]
    np.testing.assert_allclose(track.values, [5, np.arctan2(4, 3) + np.pi / 2, 2.2], rtol=1e-9)
    expected = [10 * np.cos(0.3), 0.5 + np.pi / 2, -2 / np.cos(0.3)]
    np.testing.assert_allclose(echo.values, expected, rtol=FLOAT32)
    np.testing.assert_allclose(point.values, [1.5, 2.5], rtol=1e-9)
    assert turning.values[0] == pytest.approx(-0.3, rel=1e-9)


def test_transforms_of_other_frames_turn_nothing(tmp_path):
    ros = Radar(2)
    messages = [
        ("/tf_static", 0, mounted(ros, "radar", (0.0, 0.0, 1.0), parent="trailer")),
        ("/odom", 1, ros.moving(1, (1, 2), 0.0, (3, 0), 0.25)),
        ("/tracks", 2, ros.tracks(2, [(3, 4, 1, 2)])),
    ]
    scans = read_bag(stored(tmp_path, 2, "mcap", messages))
    assert scans[1].measurements[0].values[1] == pytest.approx(np.arctan2(4, 3))


class Camera(Radar):
    """Makes objects of a camera, in one of the releases of its messages."""

    def __init__(self, version, release="zed_msgs"):
        super().__init__(version)
        self.release = release

    def objects(self, stamp_ns, items):
        """From (place, upper triangle of its covariance, state of the track or None)."""
        corner = {
            name: self.types[f"zed_msgs/msg/Keypoint{name}"](np.zeros(size, kind))
            for name, size, kind in (("2Di", 2, "u4"), ("2Df", 2, "f4"), ("3D", 3, "f4"))
        }
        box = {
            name: self.types[f"zed_msgs/msg/BoundingBox{name}"]([corner[name]] * count)
            for name, count in (("2Di", 4), ("2Df", 4), ("3D", 8))
        }
        legs = [
            self.types[f"zed_msgs/msg/Skeleton{name}"]([corner[point]] * 70)
            for name, point in (("2D", "2Df"), ("3D", "3D"))
        ]
        short, long = np.zeros(3, np.float32), np.zeros(70, np.float32)
        made = []
        for place, upper, state in items:
            values = ["Person", 1, "", 80.0, np.array(place, np.float32)]
            values += [np.array(upper, np.float32), short, state is not None, state or 0, 0]
            values += [box["2Di"], box["3D"], short, False, 0, box["2Df"], box["3D"], short, *legs]
            more = [long] if self.release != "zed_msgs" else []
            made.append(self.types[f"{self.release}/msg/Object"](*values, *more))
        kind = self.types[f"{self.release}/msg/ObjectsStamped"]
        return kind(self.header(stamp_ns, "camera"), made)


@pytest.mark.parametrize(
    ("version", "storage", "package", "release"),
    [
        (1, "bag", "zed_interfaces", "zed_msgs"),
        (2, "sqlite3", "zed_interfaces", "zed_msgs"),
        (2, "mcap", "zed_msgs", "zed_msgs"),
        (2, "mcap", "zed_msgs", "zed_msgs_70"),
    ],
)
def test_objects_of_a_camera_are_places(release, version, storage, package, tmp_path, monkeypatch):
    """Of both names of the package, of both releases; what is not seen is left out."""
    ros, upper = Camera(version, release), [0.04, 0.01, 0, 0.09, 0, 0.25]
    items = [([3, 1, 0.5], upper, None), ([5, -2, 0], [0] * 6, 1), ([7, 0, 0], upper, 2)]
    items += [([np.nan, 0, 0], upper, 1), ([9, 0, 0], upper, 0)]
    message, kind = ros.objects(5, items), f"{package}/msg/ObjectsStamped"
    form = "ros1" if version == 1 else "cdr"
    raw = getattr(ros.store, f"serialize_{form}")(message, message.__msgtype__)
    monkeypatch.setattr(ros.store, f"serialize_{form}", lambda *_: raw)
    object.__setattr__(message, "__msgtype__", kind)
    fields = ros.store.fielddefs[f"{release}/msg/ObjectsStamped"]
    monkeypatch.setitem(ros.store.fielddefs, kind, fields)
    path = tmp_path / ("run.bag" if storage == "bag" else "run")
    ros.write(path, [("/objects", 5, message)], storage)
    monkeypatch.undo()
    (scan,) = read_bag(path)
    first, second = scan.measurements
    assert (first.sensor, first.values.tolist()) == ("lidar", [3.0, 1.0])
    np.testing.assert_allclose(first.covariance, [[0.04, 0.01], [0.01, 0.09]], rtol=FLOAT32)
    assert (second.values.tolist(), second.covariance) == ([5.0, -2.0], None)
