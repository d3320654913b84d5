"""A posed scan is processed as its arrays are."""

from collections import UserDict
from types import SimpleNamespace

import numpy as np
import numpy.lib.recfunctions
import pytest
from flying_scenes import drone, yard

from lidar_core import InputError, sim
from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.flying import FlyingObjectDetector
from lidar_core.messages import PosedScan


def flights():
    return list(sim.simulate(yard(drone((6, 4, 3.5), (5, 6, 4)), scans=12), seed=0))


def sweeps():
    return list(sim.sweeps(sim.circle_scenes.several(0), seed=0, scans=6))


def pipeline_of(sweep):
    scan = sweep.scan
    return CirclePipeline(
        CirclesConfig(
            scanner=Scanner(
                scan.angle_min, scan.angle_increment, len(scan.ranges), scan.range_min, 10.0
            )
        )
    )


def test_a_detector_takes_posed_scans():
    detectors = [FlyingObjectDetector() for _ in range(3)]
    for made in flights():
        scan = made.scan
        posed = PosedScan(scan, made.poses, made.pose_stamps_ns)
        frames = [
            detectors[0].process(made),
            detectors[1].process(posed, sensor="front"),
            detectors[2].process(
                scan.points,
                made.poses,
                scan.stamp_ns,
                no_return=scan.no_return,
                directions=scan.directions,
                point_time_ns=scan.point_time_ns,
                pose_stamps_ns=made.pose_stamps_ns,
            ),
        ]
        for frame in frames[:2]:
            assert frame.stamp_ns == frames[2].stamp_ns
            assert (frame.point_class == frames[2].point_class).all()
            assert (frame.tracks.position == frames[2].tracks.position).all()
    assert len(frames[2].tracks) == 1


def test_a_pipeline_takes_posed_scans():
    found = sweeps()
    pipelines = [pipeline_of(found[0]) for _ in range(2)]
    for made in found:
        scan = made.scan
        times = scan.stamp_ns + scan.time_increment_ns * np.arange(len(scan.ranges))
        frames = [
            pipelines[0].process(made),
            pipelines[1].process(
                scan.ranges,
                made.poses,
                scan.stamp_ns,
                ray_time_ns=times,
                pose_stamps_ns=made.pose_stamps_ns,
            ),
        ]
        assert (frames[0].ranges == frames[1].ranges).all()
        assert (frames[0].map.center == frames[1].map.center).all()
    assert frames[0].scanner == made.posed.sensor
    assert len(frames[1].map) > 0


def test_scans_of_the_other_kind_and_more_arguments_are_refused():
    flight, sweep = flights()[0], sweeps()[0]
    detector, pipeline = FlyingObjectDetector(), pipeline_of(sweep)
    with pytest.raises(InputError, match="scan: expected a Scan, got LaserScan"):
        detector.process(sweep)
    with pytest.raises(InputError, match="scan: expected a LaserScan, got Scan"):
        pipeline.process(flight)
    with pytest.raises(InputError, match="stamp_ns: a posed scan holds it already; only `sensor`"):
        detector.process(flight, stamp_ns=0)
    with pytest.raises(
        InputError, match="world_from_lidar: a posed scan holds it already; only `scanner`"
    ):
        pipeline.process(sweep, np.eye(4))
    with pytest.raises(InputError, match="stamp_ns: expected an integer"):
        detector.process(flight.scan.points)
    assert detector.health().rejected == 3


RAYS = {"angle_min": -2.0, "angle_increment": 0.01, "range_min": 0.1, "range_max": 10.0}


@pytest.mark.parametrize("taker", [FlyingObjectDetector, CirclePipeline])
@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (
            SimpleNamespace(ranges=[1.0] * 5, **RAYS),
            r"got a types\.SimpleNamespace; CirclePipeline takes the array, msg\.ranges, or"
            r" lc\.io\.PosedScan\(lc\.io\.LaserScan\(stamp_ns, msg\.ranges, msg\.angle_min, ",
        ),
        (
            {"ranges": [1.0] * 5, **RAYS},
            r'got a dict; CirclePipeline takes the array, msg\["ranges"\], or ',
        ),
        (
            SimpleNamespace(data=b"0000", fields=[]),
            r"got a types\.SimpleNamespace; .* PointCloud2 .*read_points_numpy\(msg, ",
        ),
        (
            UserDict(points=np.ones((5, 3))),
            r'got a collections\.UserDict; .* shape \(N, 3\), msg\["points"\]',
        ),
        ({"x": 1}, "expected real numbers, got a dict"),
        (SimpleNamespace(), "expected real numbers, got a SimpleNamespace"),
        (None, "expected real numbers, got a NoneType"),
    ],
)
def test_messages_are_refused_with_what_to_give(taker, message, expected):
    name = "ranges" if taker is CirclePipeline else "points_lidar"
    with pytest.raises(InputError, match=f"^{name}: .*{expected}"):
        taker().process(message, np.eye(4), 0)


def test_the_fields_of_structured_points_have_a_cure():
    names = ("x", "y", "z", "intensity")
    points = np.ones(5, [(name, "<f4") for name in names])
    cure = r'structured_to_unstructured\(points_lidar\[\["x", "y", "z"\]\]\)'
    with pytest.raises(InputError, match=f"got the fields x, y, z, intensity; .*{cure}"):
        FlyingObjectDetector().process(points, np.eye(4), 0)
    with pytest.raises(InputError, match="got dtype"):
        FlyingObjectDetector().process(points[["x", "y"]], np.eye(4), 0)
    found = np.lib.recfunctions.structured_to_unstructured(points[["x", "y", "z"]])
    assert FlyingObjectDetector().process(found, np.eye(4), 0).rejected is None


class Foreign:
    """An array of another library: its memory is `data`, as that of numpy's arrays."""

    def __init__(self, values):
        self.data, self.points, self._values = values.data, None, values

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self._values, dtype)


def test_arrays_of_other_libraries_and_lists_are_taken():
    ranges = np.full(1081, 3.0, np.float32)
    points = np.ones((5, 3), np.float32)
    for number, given in enumerate((ranges, ranges.tolist(), memoryview(ranges), Foreign(ranges))):
        assert CirclePipeline().process(given, np.eye(4), number).rejected is None
    for given in (points, points.tolist(), memoryview(points), Foreign(points)):
        assert FlyingObjectDetector().process(given, np.eye(4), 0).rejected is None
