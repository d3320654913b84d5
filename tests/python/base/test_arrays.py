"""The border: what arrays pass, what is refused with which words, threads, forks, docstrings."""

import doctest
import importlib
import inspect
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import lidar_core
from lidar_core import InputError, VoxelMap, _core, arrays, cluster_points, traverse
from lidar_core.errors import LidarCoreError

RNG = np.random.default_rng(0)
CLOUD = RNG.integers(-40, 40, (60, 3)) / 8.0  # exact in every float dtype


def integrated(points):
    vmap = VoxelMap()
    vmap.integrate(points, np.ones(np.size(points) // 3, np.uint8), [0.1, 0.1, 0.1])
    return np.frombuffer(bytes(vmap._map.to_bytes()), np.uint8)


def changed(name):
    def call(points):
        vmap = VoxelMap()
        getattr(vmap, name)(points)
        return vmap.values_at(CLOUD)

    return call


def as_known_world(points):
    vmap = VoxelMap()
    vmap.set_free(CLOUD[::2])
    return vmap, points


DOORS = {
    "cluster_points": lambda points: cluster_points(points, max_distance=1.0, min_points=2),
    "integrate": integrated,
    "set_occupied": changed("set_occupied"),
    "set_free": changed("set_free"),
    "values_at": lambda points: as_known_world(points)[0].values_at(points),
    "state_at": lambda points: as_known_world(points)[0].state_at(points),
    "is_floating": lambda points: as_known_world(points)[0].is_floating(
        points, search_distance=1.0
    ),
    "classify": lambda points: VoxelMap().classify(
        points, np.zeros(np.size(points) // 3, int), [0, 0, 0]
    ),
}

strided = np.zeros((120, 6))
strided[::2, ::2] = CLOUD
backwards = CLOUD[::-1].copy()[::-1]
read_only = CLOUD.astype(np.float32)
read_only.flags.writeable = False

SAME = {
    "float32": CLOUD.astype(np.float32),
    "float16": CLOUD.astype(np.float16),
    "longdouble": CLOUD.astype(np.longdouble),
    "big endian": CLOUD.astype(">f4"),
    "fortran": np.asfortranarray(CLOUD.astype(np.float32)),
    "strided": strided[::2, ::2],
    "negative strides": backwards,
    "read-only": read_only,
    "organised": CLOUD.reshape(6, 10, 3),
    "list": CLOUD.tolist(),
    "columns of a wider cloud": np.hstack([CLOUD, CLOUD]).astype(np.float32)[:, :3],
    "integers": (CLOUD * 8).astype(np.int16) / np.float32(8),
}

BAD = {
    "one point": (np.zeros(3), "expected shape (N, 3), got (3,)"),
    "empty list": ([], "expected shape (N, 3), got (0,)"),
    "two columns": (np.zeros((0, 2)), "expected shape (N, 3), got (0, 2)"),
    "four columns": (
        np.zeros((5, 4), np.float32),
        "expected shape (N, 3), got (5, 4); slice the coordinates first",
    ),
    "transposed": (
        np.zeros((3, 100)),
        "expected shape (N, 3), got (3, 100); transpose it: points.T",
    ),
    "transposed, or three points with intensity": (
        np.zeros((3, 4)),
        "expected shape (N, 3), got (3, 4); transpose it: points.T, or slice the coordinates first",
    ),
    "wide organised cloud": (
        np.zeros((3, 5, 4)),
        "expected shape (N, 3), got (3, 5, 4); slice the coordinates first",
    ),
    "four axes": (np.zeros((1, 1, 1, 3)), "expected shape (N, 3), got (1, 1, 1, 3)"),
    "scalar": (1.0, "expected shape (N, 3), got ()"),
    "objects": (np.zeros((2, 3), object), "expected real numbers, got dtype object"),
    "complex": (np.zeros((2, 3), complex), "expected real numbers, got dtype complex128"),
    "booleans": (np.zeros((2, 3), bool), "expected real numbers, got dtype bool"),
    "text": (np.zeros((2, 3), "U3"), "expected real numbers, got dtype <U3"),
    "times": (np.zeros((2, 3), "M8[ns]"), "expected real numbers, got dtype datetime64[ns]"),
    "records": (np.zeros(2, [("x", "f4")]), "expected real numbers, got dtype [('x', '<f4')]"),
    "nothing": (None, "expected real numbers, got a NoneType"),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("layout", SAME)
def test_layout_and_dtype_do_not_matter(door, layout):
    np.testing.assert_array_equal(DOORS[door](SAME[layout]), DOORS[door](CLOUD))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", BAD)
def test_a_wrong_array_is_refused_with_both_shapes(door, name):
    array, text = BAD[name]
    with pytest.raises(InputError) as refusal:
        DOORS[door](array)
    assert str(refusal.value) == f"points: {text}"
    assert isinstance(refusal.value, ValueError)
    assert isinstance(refusal.value, LidarCoreError)


def test_ragged_lists_are_refused():
    with pytest.raises(InputError, match=r"^points: expected an array of numbers, got list: "):
        cluster_points([[0, 0, 0], [1, 1]], max_distance=1.0, min_points=1)


def test_an_empty_cloud_is_no_error():
    empty = np.zeros((0, 3), np.float32)
    assert cluster_points(empty, max_distance=1.0, min_points=1).shape == (0,)
    assert VoxelMap().values_at(empty).shape == (0,)
    assert VoxelMap().state_at(np.zeros((0, 5, 3))).shape == (0,)
    assert not VoxelMap().is_floating(empty, search_distance=1.0)


def test_a_float32_cloud_is_not_copied():
    cloud = CLOUD.astype(np.float32)
    assert arrays.as_points(cloud) is cloud
    assert np.shares_memory(arrays.as_points(cloud.reshape(6, 10, 3)), cloud)


def test_the_input_is_not_changed():
    for name, cloud in SAME.items():
        if isinstance(cloud, np.ndarray):
            before = cloud.copy()
            for door in DOORS.values():
                door(cloud)
            np.testing.assert_array_equal(cloud, before, err_msg=name)


def test_values_beyond_float32_are_no_points():
    labels = cluster_points([[1e300, 0, 0], [0, 0, 0]], max_distance=1.0, min_points=1)
    assert labels.tolist() == [-1, 0]
    assert VoxelMap(origin=(1, 2, 3)).values_at([[1e300, 0, 0], [np.nan, 0, 0]]).tolist() == [
        -740.0,
        -740.0,
    ]


@pytest.mark.parametrize(
    ("vector", "text"),
    [
        ([0, 0], "start: expected shape (3,), got (2,)"),
        ([[0, 0, 0]], "start: expected shape (3,), got (1, 3)"),
        ([0, 0, np.nan], "start: expected finite values, got [0.0, 0.0, nan]"),
        ([0, -np.inf, 0], "start: expected finite values, got [0.0, -inf, 0.0]"),
        ("abc", "start: expected real numbers, got dtype <U3"),
        ([0, 0, 1j], "start: expected real numbers, got dtype complex128"),
    ],
)
def test_a_vector_has_three_finite_values(vector, text):
    with pytest.raises(InputError) as refusal:
        traverse(vector, [1, 1, 1], voxel_size=1.0)
    assert str(refusal.value) == text


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([1, 0], "mask: expected dtype bool, got int64"),
        ([True], "mask: expected shape (2,), got (1,)"),
        (np.ones((2, 1, 1), bool), "mask: expected shape (2,), got (2, 1, 1)"),
    ],
)
def test_a_mask_is_boolean(values, text):
    with pytest.raises(InputError) as refusal:
        arrays.as_mask(values, name="mask", rows=2)
    assert str(refusal.value) == text
    assert arrays.as_mask(np.ones((2, 1), bool), name="mask", rows=2).shape == (2,)


def bad_poses():
    mirrored, scaled, sheared, row, nan = (np.eye(4) for _ in range(5))
    mirrored[0, 0] = -1
    scaled[:3, :3] *= 1.01
    sheared[0, 1] = 0.1
    row[3, 0] = 1
    nan[0, 3] = np.nan
    return {
        "mirrored": mirrored,
        "scaled": scaled,
        "sheared": sheared,
        "last row": row,
        "nan": nan,
        "3x4": np.eye(4)[:3],
        "complex": np.eye(4, dtype=complex),
    }


@pytest.mark.parametrize("name", bad_poses())
def test_a_pose_is_a_rotation_and_a_translation(name):
    with pytest.raises(InputError, match=r"^world_from_lidar: expected "):
        arrays.as_pose(bad_poses()[name])


@pytest.mark.parametrize(
    ("values", "dtype", "text"),
    [
        ([0, 300], np.uint8, "labels: expected values of uint8, got 0 to 300"),
        ([-1, 3], np.uint8, "labels: expected values of uint8, got -1 to 3"),
        ([0, 2**31], np.int32, "labels: expected values of int32, got 0 to 2147483648"),
        ([0.5, 1], np.int32, "labels: expected integers, got dtype float64"),
        ([0, 1, 2], np.int32, "labels: expected shape (2,), got (3,)"),
    ],
)
def test_integers_that_do_not_fit_are_refused(values, dtype, text):
    with pytest.raises(InputError) as refusal:
        arrays.as_rows(values, name="labels", rows=2, shape=(), dtype=dtype)
    assert str(refusal.value) == text


def test_the_core_checks_again():
    """Whoever calls the compiled module directly gets typed errors too."""
    sight = {"max_angle": 0.0, "origin": np.zeros(3)}
    options = {"max_distance": 1.0, "min_points": 1, "max_points": None, **sight}
    with pytest.raises(InputError, match=r"^points: expected shape \(N, 3\), got \[2, 4\]$"):
        _core.cluster_points(np.zeros((2, 4), np.float32), **options)
    with pytest.raises(InputError, match=r"^points: expected a C-contiguous array$"):
        _core.cluster_points(np.zeros((4, 6), np.float32)[:, ::2], **options)


def test_eight_threads_give_identical_bits():
    scans = [
        (RNG.uniform(-8, 8, (400, 3)).astype(np.float32), RNG.integers(0, 4, 400), [0.1, 0.2, 0.3])
        for _ in range(8)
    ]
    points = np.concatenate([scan[0] for scan in scans])

    def work(_):
        vmap = VoxelMap(threads=2)
        for scan in scans:
            vmap.integrate(*scan)
        vmap.remove_separate(max_gap=0.8, min_confident=2)
        labels = cluster_points(points, max_distance=0.3, min_points=2)
        classes = vmap.classify(points, labels, [0, 0, 0])
        return bytes(vmap._map.to_bytes()), labels.tobytes(), classes.tobytes()

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(work, range(8)))
    assert all(other == found[0] for other in found)


def test_eight_threads_may_share_one_map():
    scans = [RNG.uniform(-8, 8, (500, 3)).astype(np.float32) for _ in range(40)]
    shared, alone = VoxelMap(threads=2), VoxelMap()
    classes = np.full(500, 2, np.uint8)  # flying sets a value outright: the order cannot matter

    def work(scan):
        stats = shared.integrate(scan, classes, scan)
        shared.state_at(scan)
        shared.is_floating(scan[:5], search_distance=1.0)
        return stats.n_flying

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(work, scans)) == 40 * 500
    for scan in scans:
        alone.integrate(scan, classes, scan)
    assert shared._map.to_bytes() == alone._map.to_bytes()


FORK = """
import os, sys
import numpy as np
from lidar_core import InternalError, VoxelMap
vmap = VoxelMap(threads=2)
vmap.values_at(np.zeros((1, 3)))
if os.fork() == 0:
    try:
        vmap.values_at(np.zeros((1, 3)))
    except InternalError as error:
        os._exit(7 if "made before a fork" in str(error) else 8)
    os._exit(9)
sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork on this system")
def test_an_object_used_after_a_fork_says_so():
    assert subprocess.run([sys.executable, "-c", FORK], check=False).returncode == 7


def public_functions():
    for name in lidar_core.__all__:
        thing = getattr(lidar_core, name)
        if inspect.isfunction(thing):
            yield name, thing
        elif inspect.isclass(thing) and thing.__module__.startswith("lidar_core"):
            yield name, thing
            for key, value in vars(thing).items():
                if not key.startswith("_") and inspect.isfunction(inspect.unwrap(value)):
                    yield f"{name}.{key}", value


@pytest.mark.parametrize(("name", "thing"), list(public_functions()))
def test_what_is_public_is_documented(name, thing):
    text = inspect.getdoc(thing)
    assert text, name
    if inspect.isfunction(thing) and "." not in name:
        for heading in ("Parameters", "Returns", "Raises"):
            assert f"{heading}\n{'-' * len(heading)}" in text, f"{name}: {heading}"
        named = set(inspect.signature(thing).parameters)
        assert {word for word in named if word not in text} == set()


@pytest.mark.parametrize("module", ["lidar_core.geometry", "lidar_core.flying.voxel_map"])
def test_examples_in_docstrings_hold(module):
    assert doctest.testmod(importlib.import_module(module)).failed == 0


def test_masked_entries_are_refused_not_read():
    cloud = np.ma.masked_greater(np.arange(6.0).reshape(2, 3), 4)
    with pytest.raises(InputError, match="no masked entries"):
        arrays.as_points(cloud)
    assert len(arrays.as_points(np.ma.asarray(np.zeros((2, 3))))) == 2
