"""Small scans and poses with every field, and their comparison."""

import numpy as np

from lidar_core.messages import Pose, Scan

BASE_NS = 1_700_000_000_123_456_789


def make_scan(seed=0, shape=(4, 6), stamp_ns=BASE_NS):
    """A scan with every optional field."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(*shape, 3)).astype(np.float32)
    rows = points.reshape(-1, 3)
    no_return = rng.random(len(rows)) < 0.3
    rows[no_return] = np.nan
    directions = rng.normal(size=rows.shape).astype(np.float32)
    return Scan(
        stamp_ns=stamp_ns,
        points=points,
        frame_id="os_sensor",
        no_return=no_return,
        directions=directions / np.linalg.norm(directions, axis=1, keepdims=True),
        point_time_ns=stamp_ns + np.sort(rng.integers(0, 10**8, len(rows))),
        intensity=rng.random(len(rows)).astype(np.float32),
        ring=rng.integers(0, 128, len(rows)).astype(np.uint16),
        topic="/points",
    )


def make_pose(seed=0, stamp_ns=BASE_NS, *, is_static=False):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix[:3, :3] *= np.sign(np.linalg.det(matrix[:3, :3]))
    matrix[:3, 3] = rng.normal(size=3) * 1e4
    topic = "/tf_static" if is_static else "/tf"
    return Pose(stamp_ns, "map", "base", matrix, is_static=is_static, topic=topic)


def assert_same_fields(a, b):
    """Two messages of one class are equal in every value and type."""
    assert type(a) is type(b)
    for name in type(a).__slots__:
        left, right = getattr(a, name), getattr(b, name)
        if isinstance(left, np.ndarray):
            assert left.dtype == right.dtype, name
            np.testing.assert_array_equal(left, right, err_msg=name)
        else:
            assert left == right, name
