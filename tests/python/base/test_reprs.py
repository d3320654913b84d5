"""Texts of results: short, with shapes of arrays; of saved objects: what was changed."""

import numpy as np
import pytest

import lidar_core as lc
from lidar_core.messages import LaserScan, Pose, PosedScan, Scan

MOST = 600
"""Longest text of a result, whatever its arrays hold [characters]."""


def test_arrays_are_told_by_type_and_shape_and_short_ones_by_their_values():
    scan = Scan(7, np.zeros((40, 3), np.float32), "lidar")
    assert repr(scan) == "Scan(stamp_ns=7, points=float32 (40, 3), frame_id='lidar', topic='')"
    posed = PosedScan(scan, np.eye(4))
    assert repr(posed) == f"PosedScan(scan={scan!r}, world_from_lidar=float64 (4, 4))"
    assert "matrix=float64 (4, 4)" in repr(Pose(0, "world", "lidar", np.eye(4)))
    flat = LaserScan(0, np.array([1.0, 2.0], np.float32), 0.0, 0.1, 0.1, 9.0)
    assert "ranges=[1.0, 2.0]" in repr(flat)


def test_results_of_a_scan_have_short_texts():
    detector = lc.flying.FlyingObjectDetector()
    for made in lc.sim.simulate(lc.sim.scenes.demo(seed=0), seed=0, scans=1):
        frame = detector.process(made)
        assert len(repr(made)) < MOST
        assert len(repr(frame)) < 2 * MOST
        assert "point_class=uint8 (131072,)" in repr(frame)


@pytest.mark.parametrize(
    "make",
    [
        lc.flying.FlyingObjectDetector,
        lc.flying.PointCloudTracker,
        lc.VoxelMap,
        lc.circles.CirclePipeline,
        lc.circles.CircleMap,
        lc.fusion.TargetFilter,
        lc.fusion.MultiTargetTracker,
    ],
)
def test_saved_objects_tell_their_class(make):
    assert repr(make()) == f"<{make.__name__}, default configuration>"


def test_a_changed_configuration_is_told_by_the_names_of_its_tables():
    config = lc.flying.FlyingConfig(range_std=0.5, voxel_map=lc.VoxelMapConfig(voxel_size=0.5))
    told = repr(lc.flying.FlyingObjectDetector(config))
    assert told == "<FlyingObjectDetector, changed: voxel_map, range_std>"
