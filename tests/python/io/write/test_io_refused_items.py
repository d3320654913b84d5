"""Writers of recordings refuse what is no message, and values of other shapes, by their names."""

from dataclasses import replace

import numpy as np
import pytest
from small_messages import BASE_NS, make_pose, make_scan

import lidar_core as lc
import lidar_core.flying
import lidar_core.io
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.errors import InputError
from lidar_core.messages import LaserScan, PosedScan, Scan

NAMES = ["a.npz", "a.mcap", "a.bag", "a"]
POINTS = np.ones((5, 3), np.float32)
SWEEP = LaserScan(BASE_NS, np.ones(4, np.float32), 0.0, 0.1, 0.1, 9.0)

REFUSED = {
    "an array": (np.ones(3), "expected Scan, LaserScan.* got ndarray"),
    "nothing": (None, "expected Scan, LaserScan.* got NoneType"),
    "a posed scan": (PosedScan(Scan(0, POINTS), np.eye(4)), r"PosedScan; .* `posed.scan`"),
    "two columns": (Scan(0, np.ones((5, 2))), r"points: expected shape \(N, 3\), got \(5, 2\)"),
    "transposed": (Scan(0, np.ones((3, 100))), r"got \(3, 100\); transpose it: points.T"),
    "texts": (Scan(0, np.full((5, 3), "1")), "points: expected real numbers, got dtype <U1"),
    "a mask": (
        Scan(0, POINTS, no_return=np.ones(4, bool)),
        r"no_return: expected shape \(5,\), got \(4,\)",
    ),
    "times": (
        Scan(0, POINTS, point_time_ns=np.zeros(3, np.int64)),
        r"point_time_ns: expected shape \(5,\), got \(3,\)",
    ),
    "rings": (Scan(0, POINTS, ring=np.full(5, 2**16)), "ring: expected values of uint16"),
    "a stamp": (Scan(1.5, POINTS), r"stamp_ns: expected an integer \[ns\], got float"),
    "ranges": (
        replace(SWEEP, ranges=np.ones((2, 2))),
        r"ranges: expected shape \(N,\), got \(2, 2\)",
    ),
    "intensities": (
        replace(SWEEP, intensity=np.ones(3)),
        r"intensity: expected shape \(4,\), got \(3,\)",
    ),
    "a pose": (
        replace(make_pose(0, BASE_NS), matrix=np.eye(3)),
        r"matrix: expected shape \(4, 4\), got \(3, 3\)",
    ),
    "a pose that is no rotation": (
        lc.io.Pose(0, "world", "lidar", np.arange(16.0).reshape(4, 4)),
        "pose of 'lidar' in 'world' at 0 ns: matrix: expected a finite rotation and translation",
    ),
    "a pose that is not finite": (
        replace(make_pose(0, BASE_NS), matrix=np.full((4, 4), np.nan)),
        "matrix: expected a finite rotation and translation",
    ),
    "a pose as translation and quaternion": (
        lc.io.Pose(0, "world", "lidar", np.arange(7.0)),
        r"'lidar' in 'world' at 0 ns: matrix: expected shape \(4, 4\), got \(7,\)",
    ),
    "the stamp of a pose": (
        lc.io.Pose(0.5, "world", "lidar", np.eye(4)),
        r"at 0\.5 ns: stamp_ns: expected an integer \[ns\], got float",
    ),
    "a covariance": (
        replace(make_pose(0, BASE_NS), covariance=np.eye(3)),
        r"covariance: expected shape \(6, 6\), got \(3, 3\)",
    ),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_is_refused_by_its_name(tmp_path, name, case):
    item, text = REFUSED[case]
    with pytest.raises(InputError, match=text):
        lc.io.write_recording(tmp_path / name, [make_scan(), item])
    assert list(tmp_path.iterdir()) == []


def test_a_message_alone_is_no_list(tmp_path):
    with pytest.raises(InputError, match="expected a list of messages, got one Scan"):
        lc.io.write_recording(tmp_path / "a.npz", make_scan())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "points",
    [
        POINTS.tolist(),
        POINTS.astype(int),
        POINTS.astype(np.float64),
        np.ones((2, 5, 3)),
        POINTS[:0],
    ],
)
def test_points_of_other_types_are_written(tmp_path, name, points):
    lc.io.write_recording(tmp_path / name, [Scan(BASE_NS, points, topic="/points")])
    with lc.io.open_recording(tmp_path / name) as recording:
        (found,) = recording
    assert found.points.dtype == np.float32
    np.testing.assert_array_equal(found.points.reshape(-1, 3), np.reshape(points, (-1, 3)))


def test_pipelines_refuse_such_scans_too():
    with pytest.raises(InputError, match=r"expected shape \(N, 3\), got \(5, 2\)"):
        lc.flying.FlyingObjectDetector().process(PosedScan(Scan(0, np.ones((5, 2))), np.eye(4)))
    pipeline = CirclePipeline(CirclesConfig(scanner=Scanner(0.0, 0.1, 4, 0.1, 9.0)))
    with pytest.raises(InputError, match=r"ranges: expected shape \(N,\), got \(\)"):
        pipeline.process(PosedScan(replace(SWEEP, ranges=1.0), np.eye(4)))


@pytest.mark.parametrize("name", NAMES)
def test_poses_of_float32_are_written_and_read(tmp_path, name):
    """Rotations that are exact to float32 alone are rotations for writers and readers."""
    angle = np.float32(0.7)
    turned = np.eye(4, dtype=np.float32)
    turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose = replace(make_pose(0, BASE_NS), matrix=turned)
    lc.io.write_recording(tmp_path / name, [make_scan(), pose])
    with lc.io.open_recording(tmp_path / name) as recording:
        (found,) = [item for item in recording if isinstance(item, lc.io.Pose)]
    np.testing.assert_allclose(found.matrix, turned, atol=1e-6)
