"""A map at its budget: what is near stays, what is farthest goes, what cannot fit is refused."""

import copy

import numpy as np
import pytest
from typer.testing import CliRunner

import lidar_core as lc
from endurance import flight
from lidar_core.cli import app
from lidar_core.errors import LimitError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector

BLOCK = 8  # voxels along the edge of what is stored at once
SIZE = 0.25
EDGE = BLOCK * SIZE


def config(blocks, **more):
    return lc.VoxelMapConfig(voxel_size=SIZE, max_range=6.0, max_voxels=blocks * BLOCK**3, **more)


def scan_at(x, rng, count=300):
    """Points of a tunnel along x around a sensor, and their classes."""
    angle = rng.uniform(0, 2 * np.pi, count)
    along = rng.uniform(-4, 4, count)
    points = np.column_stack([x + along, 3 * np.cos(angle), 3 * np.sin(angle)])
    return points.astype(np.float32), np.full(count, lc.PointClass.BACKGROUND, np.uint8)


def fly(voxel_map, steps, *, start=0):
    """Fly along x, 1 m per scan; the stats of every scan."""
    stats = []
    for step in range(start, start + steps):
        points, classes = scan_at(float(step), np.random.default_rng(step))
        stats.append(voxel_map.integrate(points, classes, (float(step), 0.0, 0.0)))
    return stats


def around(start, end):
    """Points of a lattice of 0.25 m around the way from `start` to `end`."""
    axes = np.arange(start, end, SIZE), np.arange(-3.5, 3.6, SIZE), np.arange(-3.5, 3.6, SIZE)
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3) + SIZE / 2


def stored_blocks(voxel_map):
    """Places of the blocks that hold occupied voxels."""
    return {tuple(place) for place in np.floor(voxel_map.occupied_points() / EDGE).astype(int)}


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("skip", ["saturated", "none"])
def test_a_long_flight_is_never_refused_and_keeps_its_surroundings_to_the_bit(threads, skip):
    budget, free = 300, 10**6
    full = lc.VoxelMap(config(budget, skip=skip), threads=threads)
    whole = lc.VoxelMap(config(free, skip=skip), threads=threads)
    stats, others = fly(full, 200), fly(whole, 200)
    assert sum(one.n_voxels_forgotten for one in stats) > 0
    assert sum(one.n_voxels_forgotten for one in others) == 0
    assert len(stored_blocks(full)) <= budget
    near = around(195, 204)
    np.testing.assert_array_equal(full.values_at(near), whole.values_at(near))
    walls = whole.occupied_points()
    walls = walls[walls[:, 0] > 195]
    assert len(walls) > 100
    assert (full.state_at(walls) >= 2).all()
    far = whole.occupied_points()
    far = far[far[:, 0] < 100]
    assert len(far) > 1000
    assert (full.state_at(far) == 1).all()  # as never observed


def test_threads_forget_the_same():
    maps = [lc.VoxelMap(config(300), threads=threads) for threads in (1, 2, 3)]
    for one in maps:
        fly(one, 120)
    points = maps[0].occupied_points()
    for other in maps[1:]:
        np.testing.assert_array_equal(other.occupied_points(), points)


def test_what_is_farthest_from_the_scan_goes_first():
    voxel_map = lc.VoxelMap(config(300))
    before = set()
    for step in range(200):
        before = stored_blocks(voxel_map)
        (stats,) = fly(voxel_map, 1, start=step)
        if stats.n_voxels_forgotten:
            break
    after = stored_blocks(voxel_map)
    gone = before - after
    assert gone
    kept = before & after
    assert max(x for x, _, _ in gone) <= min(x for x, _, _ in kept)


def test_permanent_voxels_stay():
    voxel_map = lc.VoxelMap(config(300))
    known, free = np.array([[-50.0, 0.1, 0.1]]), np.array([[-60.0, 0.1, 0.1]])
    voxel_map.set_occupied(known)
    voxel_map.set_free(free)
    stats = fly(voxel_map, 200)
    assert sum(one.n_voxels_forgotten for one in stats) > 0
    assert voxel_map.state_at(known)[0] == 3
    assert voxel_map.values_at(free)[0] == -np.inf


@pytest.mark.parametrize("threads", [1, 2])
def test_a_scan_that_needs_more_than_the_budget_is_refused_and_changes_nothing(threads):
    voxel_map = lc.VoxelMap(config(60), threads=threads)
    short = np.array([[1.0, 0.0, 0.0]], np.float32)
    voxel_map.integrate(short, np.array([1], np.uint8), (0.0, 0.0, 0.0))
    before = copy.deepcopy(voxel_map)
    points, classes = scan_at(100.0, np.random.default_rng(0), 5_000)
    with pytest.raises(LimitError, match=r"voxel_map\.max_voxels"):
        voxel_map.integrate(points, classes, (100.0, 0.0, 0.0))
    np.testing.assert_array_equal(voxel_map.occupied_points(), before.occupied_points())
    line = np.column_stack([np.linspace(-1, 2, 50), np.zeros(50), np.zeros(50)])
    np.testing.assert_array_equal(voxel_map.values_at(line), before.values_at(line))


def test_a_budget_full_of_permanent_voxels_refuses():
    voxel_map = lc.VoxelMap(config(60))
    places = np.array([[EDGE * n + 0.1, 50.0, 0.0] for n in range(50)])
    voxel_map.set_occupied(places)
    with pytest.raises(LimitError, match=r"voxel_map\.max_voxels"):
        fly(voxel_map, 30)
    assert (voxel_map.state_at(places) == 3).all()


def test_separate_groups_are_found_after_the_map_has_forgotten():
    """The marks of what changed are kept by place in memory, which forgetting moves."""
    full, whole = lc.VoxelMap(config(300)), lc.VoxelMap(config(10**6))
    for one in (full, whole):
        for step in range(0, 200, 5):
            fly(one, 5, start=step)
            one.remove_separate(max_gap=2, min_confident=20)
    near = around(196, 203)
    np.testing.assert_array_equal(full.state_at(near), whole.state_at(near))


@pytest.mark.nightly
def test_the_detector_flies_on_and_says_that_it_forgot():
    flying = lc.flying.FlyingConfig(voxel_map={"max_voxels": 4_000 * BLOCK**3})
    detector = lc.flying.FlyingObjectDetector(flying, threads=1)
    rng = np.random.default_rng(0)
    ground = rng.uniform((-15, -15, -2), (15, 15, -1.9), (4_000, 3))
    walls = rng.uniform((-15, 5, -2), (15, 5.1, 4), (2_000, 3))
    for scan in range(150):
        pose = np.eye(4)
        pose[0, 3] = scan
        frame = detector.process(
            np.vstack([ground, walls]).astype(np.float32), pose, scan * 100_000_000
        )
        assert not frame.rejected
    health = detector.health()
    assert health.processed + health.held == 150
    assert health.rejected == 0
    assert health.n_voxels_forgotten > 0
    assert copy.deepcopy(detector).health() == health
    roomy = lc.flying.FlyingObjectDetector(lc.flying.FlyingConfig(), threads=1)
    roomy.process(ground.astype(np.float32), np.eye(4), 0)
    assert roomy.health().n_voxels_forgotten == 0


@pytest.mark.nightly
def test_the_summary_of_a_run_says_it_with_the_cure(tmp_path):
    def invoke(*arguments):
        done = CliRunner().invoke(app, list(map(str, arguments)))
        assert done.exit_code == 0, done.output
        return done.output

    invoke("simulate", "demo", "-o", tmp_path / "a.npz", "--scans", 20)
    told = invoke("detect", tmp_path / "a.npz", "-o", tmp_path / "a", "--no-picture")
    assert "budget" not in told
    told = invoke(
        *("detect", tmp_path / "a.npz", "-o", tmp_path / "b", "--no-picture"),
        *("--set", "voxel_map.max_voxels=1900000"),
    )
    assert "the map reached its budget of 1,900,000 voxels" in " ".join(told.split())
    assert "--set voxel_map.max_voxels=" in told


@pytest.mark.parametrize("budget", [0, 1, 511])
def test_a_budget_below_one_block_is_refused(budget):
    with pytest.raises(lc.ConfigError, match="max_voxels"):
        lc.VoxelMapConfig(max_voxels=budget)
    assert lc.VoxelMapConfig(max_voxels=512).max_voxels == 512


@pytest.mark.nightly
def test_the_background_stays_known_when_its_place_is_forgotten_and_goes_with_the_map():
    """A fast, sparse sensor surely knows the place of its start, and nothing beside the way."""
    chosen = {"voxel_map": {"max_voxels": 4_000_000}}
    detector = FlyingObjectDetector(FlyingConfig.load(chosen))
    rays, noise, pose = flight.sights(450), np.random.default_rng(0), np.eye(4)

    def frame_at(number):
        x = 5.0 * number
        pose[:3, 3] = x, 0.0, flight.HEIGHT
        ball = np.array([x + 7, 2 * np.sin(number / 57), flight.HEIGHT + np.cos(number / 40)])
        points = flight.scan(x, ball, rays, noise)
        frame = detector.process(points, pose, number * 10**8)
        flying = frame.tracks.flying.position
        return frame, len(flying) > 0 and np.linalg.norm(flying - ball, axis=1).min() < 1.0

    for number in range(70):
        frame_at(number)
    assert detector.health().n_voxels_forgotten > 0
    after = [frame_at(number) for number in range(70, 90)]
    assert all(frame.status.gate_open for frame, _ in after)
    assert np.mean([tracked for _, tracked in after]) >= 0.95
    detector.reset()
    frame, _ = frame_at(90)
    assert not frame.status.gate_open
