"""Uncertain points, voxels that were hit, targets that are met: section IV against its oracle."""

from itertools import pairwise

import numpy as np
import pytest

import lidar_core as lc
from lidar_core import ConfigError, InputError
from lidar_core.flying import detection_probability, hit_probability, point_covariance
from reference import analysis as oracle

DIFFERENCES = 1e-7
"""Relative error of central differences with steps of 1e-6."""
SCIPY = 1e-6
"""What scipy's random lattice reaches on covariances that are far from singular."""
EXACT = 2e-8
"""Stated error of the box integral, and that of the quadrature it is compared with."""


def pose(noisy):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = oracle.rotation(*noisy[3:6]), noisy[:3]
    return matrix


def random_covariance(rng, size, scale=1.0):
    root = rng.normal(size=(size, size)) * scale
    return root @ root.T / size


def rows_and_columns(rows, columns, half_deg):
    elevation = np.radians(np.linspace(half_deg, -half_deg, rows))[:, None]
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    flat = np.cos(elevation)
    parts = flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth
    return np.stack(parts, axis=-1).reshape(-1, 3)


# Covariance of points


@pytest.mark.parametrize("seed", range(20))
def test_point_covariance_is_that_of_finite_differences(seed):
    rng = np.random.default_rng(seed)
    noisy = np.concatenate([rng.normal(size=3) * 10, rng.uniform(-1.4, 1.4, 3), [0.0]])
    points = rng.normal(size=(5, 3)).astype(np.float32) * 10
    covariance = random_covariance(rng, 6, 0.1)
    got = point_covariance(points, pose(noisy), pose_covariance=covariance, range_std=0.05)
    whole = np.zeros((7, 7))
    whole[:6, :6], whole[6, 6] = covariance, 0.05**2
    for row, measured in enumerate(points.astype(float)):
        distance = np.linalg.norm(measured)
        jacobian = oracle.jacobian(np.append(noisy[:6], distance), measured / distance)
        expected = jacobian @ whole @ jacobian.T
        assert np.abs(got[row] - expected).max() <= DIFFERENCES * np.abs(expected).max()
    assert (got == got.swapaxes(1, 2)).all()


def test_points_scatter_as_their_covariance_says():
    rng = np.random.default_rng(0)
    std = np.array([0.1, 0.1, 0.05, 0.005, 0.01, 0.02, 0.05])
    at = np.array([1.0, 2.0, 3.0, 0.3, -0.2, 1.0, 12.0])
    direction = np.array([0.6, 0.48, 0.64])
    noisy = at + rng.normal(size=(20_000, 7)) * std
    sampled = np.cov(np.array([oracle.point(row, direction) for row in noisy]).T)
    got = point_covariance(
        12 * direction[None], pose(at), pose_covariance=np.diag(std[:6] ** 2), range_std=0.05
    )[0]
    assert np.abs(sampled - got).max() < 0.05 * np.abs(got).max()  # 20,000 samples: 1 %, and bends


def test_point_covariance_of_what_is_no_point():
    points = np.full((2, 3, 3), np.nan, np.float32)
    points[0, 0] = 0
    got = point_covariance(points, np.eye(4), pose_covariance=np.eye(6) * 0.01, range_std=1.0)
    assert got.shape == (6, 3, 3)
    np.testing.assert_allclose(got[0], 0.01 * np.eye(3))  # no direction: no range error
    assert np.isnan(got[1:]).all()


@pytest.mark.parametrize("range_std", [-1.0, 101.0, 1e200, np.inf, np.nan])
def test_a_range_error_that_says_nothing_is_refused(range_std):
    with pytest.raises(ConfigError, match=r"range_std: expected 0 to 100 \[m\]"):
        point_covariance([[1, 0, 0]], np.eye(4), pose_covariance=np.eye(6), range_std=range_std)


@pytest.mark.parametrize("scale", [1e-12, 1e-9, 1e-3, 1.0])
def test_pose_covariances_are_judged_at_any_scale(scale):
    def call(matrix):
        return point_covariance([[1, 0, 0]], np.eye(4), pose_covariance=matrix, range_std=0.0)

    asymmetric = np.eye(6)
    asymmetric[0, 1] = 0.5
    indefinite = np.eye(6)
    indefinite[0, 1] = indefinite[1, 0] = 1.1
    with pytest.raises(InputError, match="pose_covariance: expected a finite symmetric matrix"):
        call(scale * asymmetric)
    for matrix in (indefinite, np.diag([1.0] * 5 + [-1.0])):
        with pytest.raises(InputError, match="pose_covariance: expected no negative eigenvalue"):
            call(scale * matrix)
    root = np.random.default_rng(0).normal(size=(6, 2))  # singular, and rounded to float32
    assert np.isfinite(call((scale * root @ root.T).astype(np.float32))).all()
    assert (call(np.zeros((6, 6))) == 0).all()


# Voxels that were hit


@pytest.mark.ci_cases("0", "5", "10")
@pytest.mark.parametrize("seed", range(25))
def test_hit_probability_agrees_with_scipy(seed):
    rng = np.random.default_rng(seed)
    covariance = random_covariance(rng, 3, 10 ** rng.uniform(-2, 0, (3, 1)))
    covariance += 0.1 * np.diag(np.diag(covariance))  # scipy is worse near singular ones
    measured, size = rng.uniform(-5, 5, 3), 10 ** rng.uniform(-1, 0.5)
    (got,) = hit_probability(measured[None], covariance, voxel_size=size)
    low = np.floor(measured / size) * size - measured
    assert abs(got - oracle.box(covariance, low, low + size)) < SCIPY


@pytest.mark.parametrize("seed", range(25))
@pytest.mark.parametrize("thickness", [0.0, 1e-9, 1e-6, 1e-4])
def test_hit_probability_of_flat_covariances(seed, thickness):
    rng = np.random.default_rng(seed)
    a, b, normal = np.linalg.qr(rng.normal(size=(3, 3)))[0].T * [[0.2], [0.05], [thickness]]
    covariance = np.outer(a, a) + np.outer(b, b) + np.outer(normal, normal)
    measured = rng.uniform(-5, 5, 3)
    (got,) = hit_probability(measured[None], covariance, voxel_size=0.25)
    low = np.floor(measured / 0.25) * 0.25 - measured
    expected = oracle.plane_box(a, b, low, low + 0.25)
    assert abs(got - expected) < EXACT + 20 * thickness  # the oracle has no thickness


@pytest.mark.parametrize("seed", range(10))
def test_hit_probability_along_a_line(seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3) * 0.2
    measured = rng.uniform(-5, 5, 3)
    (got,) = hit_probability(measured[None], np.outer(direction, direction), voxel_size=0.25)
    low = np.floor(measured / 0.25) * 0.25 - measured
    bounds = np.sort(np.stack([low, low + 0.25]) / direction, axis=0)
    start, end = bounds[0].max(), bounds[1].min()
    assert abs(got - max(0.0, oracle.norm.cdf(end) - oracle.norm.cdf(start))) < EXACT


def test_hit_probability_grows_with_the_voxel_and_is_shared_by_threads():
    rng = np.random.default_rng(1)
    points = rng.uniform(-10, 10, (3000, 3))
    covariance = point_covariance(
        points, np.eye(4), pose_covariance=np.eye(6) * 1e-4, range_std=0.03
    )
    small, large = (
        hit_probability(points, covariance, voxel_size=size, origin=(-16.0, -16.0, -16.0))
        for size in (0.25, 1.0)
    )
    assert (large >= small - EXACT).all()  # a voxel of 1 m holds that of 0.25 m
    again = hit_probability(
        points, covariance, voxel_size=0.25, origin=(-16.0, -16.0, -16.0), threads=3
    )
    assert (again == small).all()


def test_hit_probability_far_from_the_origin_and_without_a_point():
    points = np.array([[4e6 + 0.125, 0.125, 0.125], [np.nan, 0, 0]])
    got = hit_probability(points, 0.01 * np.eye(3), voxel_size=0.25)
    assert abs(got[0] - (2 * oracle.norm.cdf(1.25) - 1) ** 3) < EXACT
    assert np.isnan(got[1])


def test_hit_probability_of_an_organised_cloud():
    points = np.random.default_rng(3).uniform(-5, 5, (4, 6, 3))
    covariance = point_covariance(
        points, np.eye(4), pose_covariance=np.eye(6) * 1e-4, range_std=0.03
    )
    got = hit_probability(points, covariance, voxel_size=0.25)
    flat = hit_probability(points.reshape(-1, 3), covariance, voxel_size=0.25)
    assert got.shape == (24,)
    assert (got == flat).all()
    with pytest.raises(InputError, match=r"points_world: expected shape \(N, 3\)"):
        hit_probability(points[..., :2], covariance, voxel_size=0.25)


NO_COVARIANCES = [
    np.diag([1.0, 1.0, -1.0]),
    np.diag([1e-10, 1e-10, -1e-10]),
    np.full((3, 3), np.nan),
    np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]]),
    np.array([[1.0, 0.1, 0], [0, 1, 0], [0, 0, 1]]),
]


@pytest.mark.parametrize("covariance", NO_COVARIANCES)
def test_what_is_no_covariance_is_refused_by_its_row(covariance):
    with pytest.raises(InputError, match=r"covariance\[0\]: expected finite, symmetric, without"):
        hit_probability([[0, 0, 0]], covariance, voxel_size=0.25)
    rows = np.stack([np.eye(3), np.zeros((3, 3)), covariance, covariance])
    with pytest.raises(InputError, match=r"covariance\[2\]"):
        hit_probability(np.zeros((4, 3)), rows, voxel_size=0.25)
    points = np.zeros((4, 3))
    points[2:] = np.nan  # as point_covariance gives it: no point, no covariance
    got = hit_probability(points, rows, voxel_size=0.25)
    assert np.isfinite(got[:2]).all()
    assert np.isnan(got[2:]).all()


def test_covariances_of_the_wrong_shape_are_refused():
    with pytest.raises(InputError, match=r"covariance: expected shape \(3, 3\) or \(1, 3, 3\)"):
        hit_probability([[0, 0, 0]], np.eye(2), voxel_size=0.25)


@pytest.mark.parametrize("threads", [0, -1, 257, 2**63, 2**70, -(2**70)])
def test_threads_out_of_range_are_refused(threads):
    with pytest.raises(ConfigError, match="threads: expected"):
        hit_probability([[0, 0, 0]], np.eye(3), voxel_size=0.25, threads=threads)
    with pytest.raises(ConfigError, match="threads: expected"):
        lc.VoxelMap(lc.VoxelMapConfig(), threads=threads)


# Targets that are met


@pytest.mark.parametrize("distance", [0.6, 2.0, 20.0, 300.0])
def test_one_ray_meets_the_area_of_its_cap(distance):
    """Eq. 48."""
    (got,) = detection_probability([[0.0, 0.0, -2.0]], radius=0.5, distance=distance)
    assert got == pytest.approx((1 - np.sqrt(1 - (0.5 / distance) ** 2)) / 2, rel=1e-9)


@pytest.mark.parametrize("length", [5e-324, 1e-200, 1e-160, 1e160, 1e200, 1.7e308])
def test_directions_have_any_length(length):
    expected = detection_probability([[0, 1, 0]], radius=0.5, distance=5.0)
    assert detection_probability([[0, length, 0]], radius=0.5, distance=5.0) == expected


@pytest.mark.ci_cases("rows-view0", "random-view1")
@pytest.mark.parametrize("view", [(-np.pi / 2, np.pi / 2), (-0.45, 0.3)])
@pytest.mark.parametrize("kind", ["rows", "random", "clumped"])
def test_detection_probability_agrees_with_random_targets(kind, view):
    rng = np.random.default_rng(7)
    directions = {
        "rows": rows_and_columns(16, 90, 22.5),
        "random": rng.normal(size=(500, 3)),
        "clumped": rng.normal(size=(300, 3)) * [0.05, 1.0, 0.3] + [1.0, 0.0, 0.0],
    }[kind]
    directions = np.concatenate([directions, directions[::7]])  # some twice
    distances = np.array([0.35, 1.0, 4.0, 15.0, 60.0])
    got = detection_probability(directions, radius=0.325, distance=distances, field_of_view=view)
    targets = 20_000
    for probability, distance in zip(got, distances, strict=True):
        share = oracle.met_share(directions, 0.325, distance, view, targets, seed=3)
        std = np.sqrt(max(probability * (1 - probability), 1e-4) / targets)
        assert abs(share - probability) < 4 * std


def test_detection_probability_does_not_depend_on_order_or_threads():
    directions = rows_and_columns(32, 200, 20)
    arguments = {"radius": 0.3, "distance": [1.0, 8.0, 30.0], "field_of_view": (-0.3, 0.3)}
    first = detection_probability(directions, **arguments)
    order = np.random.default_rng(0).permutation(len(directions))
    for other in (directions[order], np.repeat(directions, 2, axis=0)):
        assert (detection_probability(other, threads=3, **arguments) == first).all()


def test_limits_of_the_detection_probability():
    nobody = detection_probability(np.empty((0, 3)), radius=1.0, distance=[0.5, 5.0])
    assert nobody.tolist() == [0.0, 0.0]
    inside = detection_probability([[1, 0, 0]], radius=1.0, distance=[0.0, 1.0])
    assert inside.tolist() == [1.0, 1.0]
    dense = rows_and_columns(128, 1024, 22.5)
    band = (-np.radians(22.5), np.radians(22.5))
    (sure,) = detection_probability(dense, radius=0.325, distance=20.0, field_of_view=band)
    assert sure == 1.0
    up = detection_probability([[0, 0, 1]], radius=0.5, distance=2.0, field_of_view=(1.2, 1.5707))
    assert 0 < up[0] <= 1


def test_the_whole_sphere_is_made_of_bands():
    directions = np.random.default_rng(2).normal(size=(400, 3))
    cuts = [-np.pi / 2, -0.7, -0.1, 0.4, 1.1, np.pi / 2]
    (whole,) = detection_probability(directions, radius=0.4, distance=5.0)
    parts = [
        (np.sin(high) - np.sin(low))
        / 2
        * detection_probability(directions, radius=0.4, distance=5.0, field_of_view=(low, high))[0]
        for low, high in pairwise(cuts)
    ]
    assert sum(parts) == pytest.approx(whole, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"directions": [[0, 0, 0]]}, InputError, r"directions\[0\]: expected a direction"),
        ({"directions": [[1, 0]]}, InputError, r"directions: expected shape \(N, 3\)"),
        ({"distance": [1.0, -1.0]}, InputError, r"distance\[1\]: expected finite and >= 0"),
        ({"distance": [[1.0]]}, InputError, "distance: expected shape"),
        ({"radius": 0.0}, ConfigError, "radius: expected finite and > 0"),
        ({"directions": [[np.inf, 0, 0]]}, InputError, r"directions\[0\]: expected a direction"),
        ({"directions": [[1, np.nan, 0]]}, InputError, r"directions\[0\]: expected a direction"),
        ({"threads": 0}, ConfigError, "threads"),
        ({"threads": 2**70}, ConfigError, "threads: expected 1 to 256, got 1180591620717411303424"),
        ({"field_of_view": (1,)}, InputError, r"field_of_view: expected shape \(2,\)"),
        ({"field_of_view": "wide"}, InputError, "field_of_view"),
        ({"field_of_view": (0.5, 0.1)}, ConfigError, "field_of_view: expected least and largest"),
        ({"field_of_view": (0.0, 2.0)}, ConfigError, "field_of_view"),
    ],
)
def test_what_cannot_be_met_is_refused(changes, error, text):
    arguments = {"directions": [[1, 0, 0]], "radius": 1.0, "distance": 5.0} | changes
    with pytest.raises(error, match=text):
        detection_probability(arguments.pop("directions"), **arguments)


@pytest.mark.nightly
def test_the_simulated_share_of_scans_is_predicted():
    """A ball anywhere at 20 m: in how many scans does the simulator hit it?"""
    from lidar_core import sim

    pattern = sim.Spinning(elevations_deg=tuple(np.linspace(20, -20, 12).tolist()), columns=120)
    lidar = sim.LidarModel(pattern=pattern, snapshot=True)
    rng = np.random.default_rng(5)
    height = rng.uniform(-np.sin(np.radians(25)), np.sin(np.radians(25)), 600)
    azimuth, flat = rng.uniform(-np.pi, np.pi, 600), np.sqrt(1 - height**2)
    places = 20 * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=-1)
    hits = []
    for place in places:
        target = sim.Target(shape=sim.Sphere(radius=0.5), motion=sim.Hover(position=tuple(place)))
        scene = sim.Scene(
            bodies=(),
            targets=(target,),
            lidar=lidar,
            sensor=sim.Hover(position=(0.0, 0.0, 0.0)),
            scans=1,
        )
        (simulated,) = sim.simulate(scene, seed=1)
        hits.append(np.isfinite(simulated.scan.points).all(axis=-1).any())
    view = (-np.radians(25), np.radians(25))
    (expected,) = detection_probability(
        simulated.scan.directions.reshape(-1, 3), radius=0.5, distance=20.0, field_of_view=view
    )
    assert 0.2 < expected < 0.8
    assert abs(np.mean(hits) - expected) < 4 * np.sqrt(expected * (1 - expected) / 600)


def test_names_are_public():
    for name in ("point_covariance", "hit_probability", "detection_probability"):
        assert getattr(lc.flying, name).__doc__
