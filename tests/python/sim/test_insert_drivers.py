"""Targets in clouds as drivers deliver them: what is taken out and put back has as many returns."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from archives import unpack
from scipy.spatial import Delaunay

from lidar_core import InputError, sim
from lidar_core.io import open_recording
from lidar_core.messages import PosedScan, Scan
from lidar_core.sim.insertion.ray_scan import SensorWay

SCANS = 12
SHAPES = {
    "sphere": sim.Sphere(radius=0.325),
    "hexacopter": sim.Hexacopter(radius=0.45),
    "quadcopter": sim.Quadcopter(radius=0.35),
}
STREET = (
    sim.Body(shape=sim.Plane(size=(80.0, 80.0)), position=(0, 0, -2.0)),
    sim.Body(shape=sim.Box(size=(2.0, 60.0, 12.0)), position=(14.0, 0.0, 4.0)),
    sim.Body(shape=sim.Box(size=(40.0, 2.0, 4.0)), position=(0.0, 20.0, 0.0)),
)
FLIGHTS = {
    "sky": sim.Waypoints(times=(0.0, 2.0), positions=((-3.0, 4.0, 1.2), (-1.0, 5.0, 1.6))),
    "house": sim.Waypoints(times=(0.0, 2.0), positions=((6.0, -1.0, 0.3), (6.5, 1.5, 0.8))),
    "front": sim.Waypoints(times=(0.0, 2.0), positions=((5.0, -0.5, 1.5), (5.0, 1.0, 2.0))),
}
CAR = sim.Waypoints(times=(0.0, 2.0), positions=((0.0, -4.0, 0.0), (0.0, 0.0, 0.0)))


def scene(preset, shape, flight, *, sensor=CAR, **changes):
    return sim.Scene(
        bodies=STREET,
        targets=(sim.Target(shape=SHAPES[shape], motion=FLIGHTS[flight]),),
        lidar=sim.LidarModel.preset(preset, **changes),
        sensor=sensor,
        scans=SCANS,
    )


def without(made):
    """The scan with the target's returns taken out, as the driver gives rays without return."""
    scan, is_it = made.scan, made.label == len(STREET)
    if made.scan.points.ndim == 2 and not (made.label == -1).any():
        left = ~is_it
        return replace(
            scan,
            points=scan.points[left],
            point_time_ns=scan.point_time_ns[left],
            ring=None if scan.ring is None else scan.ring[left],
        )
    points = scan.points.copy()
    points.reshape(-1, 3)[is_it] = np.nan if points.ndim == 3 else 0
    return replace(scan, points=points)


def put_back(made, shape, flight, pattern, *, deskewed=False):
    posed = [
        PosedScan(deskew(one) if deskewed else without(one), one.poses, one.pose_stamps_ns)
        for one in made
    ]
    return sim.with_moving_target(
        posed,
        SHAPES[shape],
        FLIGHTS[flight],
        seed=1,
        pattern=pattern,
        deskewed=deskewed,
        range_max=100.0,
        range_std=0.02,
        seconds=2.0,
    )


def deskew(made):
    """The target taken out, and the motion: all points in the sensor's frame at the stamp."""
    scan = without(made)
    points = scan.points.reshape(-1, 3).astype(np.float64)
    way = SensorWay(made.pose_stamps_ns, made.poses)
    moved = np.linalg.inv(way.at(np.array([scan.stamp_ns]))[0]) @ way.at(scan.point_time_ns)
    points = np.einsum("mij,mj->mi", moved[:, :3, :3], points) + moved[:, :3, 3]
    return replace(scan, points=points.astype(np.float32).reshape(scan.points.shape))


@pytest.mark.parametrize(
    ("preset", "shape", "flight"),
    [
        ("vlp-16", "sphere", "sky"),
        ("hdl-32e", "quadcopter", "house"),
        ("xt32", "quadcopter", "sky"),
        ("livox-mid360", "hexacopter", "house"),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                ("vlp-16", "hexacopter", "house"),
                ("hdl-32e", "hexacopter", "sky"),
                ("xt32", "sphere", "house"),
                ("os1-64", "hexacopter", "sky"),
                ("os1-64", "quadcopter", "house"),
                ("livox-mid360", "sphere", "sky"),
            )
        ),
    ],
)
def test_what_is_put_back_has_as_many_returns_as_what_was_taken_out(preset, shape, flight):
    check(preset, shape, flight)


@pytest.mark.ci_cases("livox-avia")
@pytest.mark.parametrize("preset", ["livox-avia", "livox-hap"])
def test_the_same_of_sensors_that_look_ahead(preset):
    check(preset, "hexacopter", "front" if preset == "livox-avia" else "house")


@pytest.mark.ci_cases("vlp-16")
@pytest.mark.parametrize("preset", ["vlp-16", "livox-mid360"])
def test_the_same_of_clouds_without_their_motion(preset):
    check(preset, "hexacopter", "sky", deskewed=True)


@pytest.mark.ci_cases("livox-mid360")
@pytest.mark.parametrize("preset", ["livox-mid360", "livox-avia"])
def test_the_same_of_rosettes_whose_driver_drops_rows(preset):
    flight = "sky" if preset == "livox-mid360" else "front"
    check(preset, "hexacopter", flight, delivery="dropped")


def check(preset, shape, flight, *, deskewed=False, **changes):
    world = scene(preset, shape, flight, **changes)
    made = list(sim.simulate(world, seed=3))
    dropped = world.lidar.delivery == "dropped" and world.lidar.pattern.kind == "rosette"
    pattern = (
        sim.RayPattern.of_model(world.lidar)
        if dropped
        else sim.RayPattern.of_scans([without(one) for one in made])
    )
    back = list(put_back(made, shape, flight, pattern, deskewed=deskewed))
    truly = sum(int(one.truth.hits[0]) for one in made)
    again = sum(int(one.truth.hits[0]) for one in back)
    assert truly > 40
    assert again == pytest.approx(truly, rel=0.1)
    for one, other in zip(back, made, strict=True):
        assert one.truth.position[0] == pytest.approx(other.truth.position[0], abs=1e-6)
        assert one.truth.velocity[0] == pytest.approx(other.truth.velocity[0], abs=1e-3)
        assert (one.label == 1).sum() == one.truth.hits[0]
        assert len(one.label) == len(one.scan.points.reshape(-1, 3))


ISOLATED = {
    "left": ((52.42, -5.42, 8.49), (1.14, 1.2, 3.16)),
    "middle": ((44.16, -2.08, 7.39), (1.02, 1.2, 2.7)),
    "near": ((18.74, 26.92, 0.41), (1.52, 0.94, 2.46)),
}
"""Compact things that stand alone in the recording: middle, half sizes with 0.4 m of margin [m]."""


@pytest.fixture(scope="module")
def outdoor(recordings, tmp_path_factory):
    """Scans of a Livox HAP that stands."""
    packed = recordings / "3d" / "sequences" / "livox_hap_outdoor" / "scans.tar.xz"
    if not packed.exists():
        pytest.skip(f"{packed} is not there")
    folder = tmp_path_factory.mktemp("hap")
    unpack(packed, folder)
    scans = []
    for path in sorted(folder.glob("**/*.pcd")):
        with open_recording(path) as recording:
            scans.append(next(one for one in recording if isinstance(one, Scan)))
    return scans


@pytest.mark.ci_cases("middle", "near")
@pytest.mark.parametrize("name", ISOLATED)
def test_a_real_thing_that_is_put_back_has_as_many_returns(name, outdoor):
    """Its shape is what scans 10 to 29 show of it; it is taken out of scans 0 to 9."""
    middle, half = (np.array(one) for one in ISOLATED[name])
    pattern = sim.RayPattern.of_scans(outdoor[:10])

    def is_part(scan):
        return (np.abs(scan.points - middle) <= half).all(axis=1)

    shape = front_of(np.concatenate([scan.points[is_part(scan)] for scan in outdoor[10:]]))
    truly = again = 0
    for number, scan in enumerate(outdoor[:10]):
        gone = is_part(scan)
        points = np.where(gone[:, None], np.float32(np.nan), scan.points)
        bare = replace(scan, points=points, no_return=scan.no_return | gone)
        _, is_hit = sim.insert_target(
            bare,
            (0, 0, 0),
            shape=shape,
            range_max=150.0,
            range_std=0.02,
            pattern=pattern,
            rng=np.random.default_rng(number),
        )
        truly += gone.sum()
        again += is_hit.sum()
    assert truly > 500
    assert again == pytest.approx(truly, rel=0.1)


def front_of(points):
    """Triangles between the directions of points, without those that bridge gaps."""
    x, y, z = points.T.astype(np.float64)
    angles = np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
    faces = Delaunay(angles).simplices
    corners = points[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return points.astype(np.float64), faces[longest < 0.5]


def street(**changes):
    """One scan of a VLP-16 that stands, as its driver gives it."""
    world = scene("vlp-16", "sphere", "sky", sensor=sim.Hover(position=(0, 0, 0)), **changes)
    return without(next(sim.simulate(world, seed=0)))


def put(scan, **changes):
    settings = {
        "shape": sim.Sphere(radius=0.5),
        "range_max": 100.0,
        "range_std": 0.0,
        "rng": np.random.default_rng(0),
    } | changes
    return sim.insert_target(scan, (6.0, 0.0, 1.0), **settings)


def test_rays_whose_rows_were_dropped_need_a_pattern():
    scan = street()
    high = {"rng": np.random.default_rng(0), "range_max": 100.0, "range_std": 0.0, "radius": 0.5}
    sky = (-6.0, 0.0, 1.2)
    unknown, none = sim.insert_target(scan, sky, **high)
    known, hits = sim.insert_target(scan, sky, pattern=sim.RayPattern.of_scans([scan]), **high)
    assert none.sum() == 0
    assert hits.sum() > 20
    assert len(known.points) == len(unknown.points) + hits.sum()
    assert len(known.point_time_ns) == len(known.ring) == len(known.points)
    away = np.linalg.norm(known.points[hits] - np.array(sky), axis=1)
    np.testing.assert_allclose(away, 0.5, atol=1e-5)
    given = sim.RayPattern.of_model(sim.LidarModel.preset("vlp-16"))
    _, preset = sim.insert_target(scan, sky, pattern=given, **high)
    assert preset.sum() == pytest.approx(hits.sum(), rel=0.1)


def test_rows_of_what_it_hides_are_dropped_and_rows_before_it_stay():
    scan = street()
    seen, is_hit = put(scan)
    assert is_hit.sum() > 20
    assert len(seen.points) == len(scan.points)  # a house stands behind all of it
    near, hit = put(scan, range_min=8.0)
    assert hit.sum() == 0
    assert len(near.points) == len(scan.points) - is_hit.sum()
    hidden = sim.insert_target(
        scan,
        (30.0, 0.0, 1.0),
        radius=0.5,
        range_max=100.0,
        range_std=0.0,
        rng=np.random.default_rng(0),
    )
    assert hidden[1].sum() == 0


def test_several_returns_of_a_ray_become_one_and_nearer_ones_stay():
    scan = street()
    behind = scan.points + 0.5 * scan.points / np.linalg.norm(scan.points, axis=1, keepdims=True)
    before = 2.0 * scan.points / np.linalg.norm(scan.points, axis=1, keepdims=True)
    double = replace(
        scan,
        points=np.concatenate([scan.points, behind, before[::50]]).astype(np.float32),
        point_time_ns=np.concatenate([scan.point_time_ns] * 2 + [scan.point_time_ns[::50]]),
        ring=np.concatenate([scan.ring, scan.ring, scan.ring[::50]]),
    )
    _, hits = put(scan)
    seen, is_hit = put(double)
    assert is_hit.sum() == hits.sum() > 20
    assert len(seen.points) == len(double.points) - hits.sum()
    leaves = np.linalg.norm(seen.points, axis=1)
    assert (np.abs(leaves - 2.0) < 1e-3).sum() == len(before[::50])


def test_meshes_come_as_arrays_as_shapes_or_from_trimesh():
    scan = street()
    vertices, faces = sim.sphere_mesh(0.5, rings=24, sectors=48)
    ways = [
        (vertices, faces),
        trimesh.Trimesh(vertices, faces),
        sim.Mesh(vertices=vertices.tolist(), faces=faces.tolist()),
    ]
    masks = [put(scan, shape=shape)[1] for shape in ways]
    assert masks[0].sum() > 20
    for mask in masks[1:]:
        np.testing.assert_array_equal(mask, masks[0])
    person = put(scan, shape=sim.Person())[1]
    assert person.sum() > 3
    turned = put(scan, shape=sim.Box(size=(0.1, 0.1, 2.0)), rotation=(0.70710678, 0, 0, 0.70710678))
    spread = np.ptp(turned[0].points[turned[1]], axis=0)
    assert spread[1] > 1.5 > 0.3 > spread[2]


def test_what_is_no_shape_is_refused():
    scan = street()
    with pytest.raises(InputError, match="shape: expected a shape of"):
        put(scan, shape="drone")
    with pytest.raises(InputError, match="radius, shape: expected one of them"):
        put(scan, radius=1.0)
    with pytest.raises(InputError, match="lidar: expected a 3D one"):
        sim.RayPattern.of_model(sim.LidarModel.preset("utm-30lx"))
    with pytest.raises(InputError, match="scans: expected at least one scan with returns"):
        sim.RayPattern.of_scans([replace(scan, points=scan.points[:0], ring=scan.ring[:0])])
    posed = PosedScan(scan, np.tile(np.eye(4), (2, 1, 1)), np.array([0]))
    with pytest.raises(InputError, match="pose_stamps_ns: expected 2"):
        next(sim.with_moving_target([posed], SHAPES["sphere"], FLIGHTS["sky"], seed=0))


def test_single_poses_are_joined_to_a_way_and_a_target_can_keep_up():
    world = scene("vlp-16", "sphere", "sky")
    made = list(sim.simulate(world, seed=3))
    posed = [PosedScan(without(one), one.world_from_lidar) for one in made]
    escort = sim.Hover(position=(-5.0, 0.0, 1.0))
    pattern = sim.RayPattern.of_scans([one.scan for one in posed])
    found = list(
        sim.with_moving_target(
            posed, SHAPES["sphere"], escort, seed=0, follows=True, pattern=pattern, range_std=0.0
        )
    )
    for one, other in zip(found, made, strict=True):
        expected = other.world_from_lidar[:3, 3] + [-5.0, 0.0, 1.0]
        np.testing.assert_allclose(one.truth.position[0], expected, atol=1e-9)
        assert one.truth.hits[0] > 10
        away = np.linalg.norm(one.scan.points[one.label == 1] - [-5.0, 0.0, 1.0], axis=1)
        np.testing.assert_allclose(away, 0.325, atol=1e-5)
    np.testing.assert_allclose(found[3].truth.velocity[0], [0.0, 2.0, 0.0], atol=1e-6)
    again = list(
        sim.with_moving_target(
            posed, SHAPES["sphere"], escort, seed=0, follows=True, pattern=pattern, range_std=0.0
        )
    )
    for one, other in zip(found, again, strict=True):
        np.testing.assert_array_equal(one.scan.points, other.scan.points)
