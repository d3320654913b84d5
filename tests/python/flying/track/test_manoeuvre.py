"""Targets that turn harder than the motion model expects, and those that do not."""

import numpy as np
import pytest
from flying_scenes import feed, lidar, scans_of, yard

from lidar_core.flying import FlyingConfig, FlyingObjectDetector, PointCloudTracker, TrackerConfig
from lidar_core.sim import Circle, Sphere, Target, Waypoints
from reference import tracker as oracle

FINE = lidar(rows=128, columns=1024)
PLACE = (6.0, 4.0, 3.0)
FREE = 20  # scans until a new target is surely a track


def flown(motion, process_noise):
    """Places of the target, and the flying tracks, of every scan."""
    config = FlyingConfig(tracker={"process_noise": process_noise})
    detector = FlyingObjectDetector(config)
    scene = yard(Target(shape=Sphere(radius=0.15), motion=motion), scans=60, lidar=FINE)
    scans = list(scans_of(scene))
    return [scan.truth.position[0] for scan in scans], [
        feed(detector, scan).tracks.flying for scan in scans
    ]


def errors_of(places, tracks):
    """Distance of the only flying track from the target; infinite where there is none."""
    return np.array(
        [
            np.linalg.norm(track.position[0] - place) if len(track) == 1 else np.inf
            for place, track in zip(places[FREE:], tracks[FREE:], strict=True)
        ]
    )


LATER = [pytest.param(*one, marks=pytest.mark.nightly) for one in [(0.7, 3.0), (0.8, 3.5)]]


@pytest.mark.nightly
@pytest.mark.parametrize(("radius", "speed"), [(0.6, 3.0), *LATER])
def test_a_target_on_a_tight_circle_is_followed(radius, speed):
    """At 13 to 15 m/s^2, where the process noise that is told stands for some 4."""
    motion = Circle(center=PLACE, radius=radius, speed=speed)
    places, tracks = flown(motion, "adaptive")
    errors = errors_of(places, tracks)
    assert len({number for track in tracks for number in track.id.tolist()}) == 1
    calm = errors_of(*flown(motion, "continuous"))
    assert np.isfinite([errors, calm]).all()
    assert np.median(errors) < 0.8 * np.median(calm)


@pytest.mark.nightly
def test_a_target_that_flies_straight_on_is_told_as_surely_as_before():
    motion = Waypoints(times=(0.0, 6.0), positions=((6.0, -4.0, 3.0), (6.0, 5.0, 3.0)))
    of = {noise: flown(motion, noise) for noise in ("adaptive", "continuous")}
    spreads = {
        noise: np.mean([np.trace(track.covariance[0, :3, :3]) for track in tracks[FREE:]])
        for noise, (_, tracks) in of.items()
    }
    assert spreads["adaptive"] <= 1.1 * spreads["continuous"]
    assert errors_of(*of["adaptive"]).max() <= 0.2


# --- few scans per second -------------------------------------------------------------------------

SLOW_NS = 200_000_000  # 5 Hz
BODY = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.15, 0.15) for z in (-0.1, 0.1)])
NOTHING = np.empty((0, 3))
SURE = np.diag([4e-4] * 3)[None]  # covariance of a detection [m^2]


def on_a_circle(scans, *, radius=0.4, speed=2.4):
    """Places of a target that turns by 69 degrees from scan to scan, at 14 m/s^2, (N, 3)."""
    angle = speed / radius * 0.2 * np.arange(scans)
    return np.stack([8 + radius * np.cos(angle), radius * np.sin(angle), 3 + 0 * angle], axis=1)


def config(process_noise):
    return TrackerConfig(process_noise=process_noise, measurement_std=0.02)


def numbers_on(places, process_noise):
    """IDs of the reported tracks in every scan."""
    tracker = PointCloudTracker(config(process_noise))
    numbers = []
    for k, place in enumerate(places):
        tracker.new_point_cloud(place + BODY, NOTHING, k * SLOW_NS)
        tracker.new_detections(place[None], k * SLOW_NS, covariance=SURE)
        numbers.append(tracker.tracks_at(k * SLOW_NS).id.tolist())
    return numbers


def test_a_target_that_turns_hard_between_two_scans_keeps_its_number():
    """The acceleration of the last scans says nothing about that of the next ones."""
    places = on_a_circle(40)
    assert numbers_on(places, "adaptive")[8:] == [[0]] * 32
    assert numbers_on(places, "continuous")[8:] != [[0]] * 32  # without hard turns it is lost


@pytest.mark.parametrize(
    ("aside", "process_noise", "is_found"),
    [
        (0.1, "continuous", True),
        (0.6, "adaptive", True),
        (0.6, "continuous", False),
        (1.3, "adaptive", False),
    ],
)
def test_a_cluster_aside_is_of_a_target_as_far_as_one_can_turn(aside, process_noise, is_found):
    """It flies straight on at 2 m/s. 0.6 m aside within 0.2 s take 30 m/s^2, 1.3 m take 65."""
    tracker = PointCloudTracker(config(process_noise))
    for k in range(12):
        place = np.array([8.0, 0.4 * k, 3.0 + aside * (k == 11)])
        events = tracker.new_point_cloud(place + BODY, NOTHING, k * SLOW_NS)
        tracker.new_detections(place[None] if k < 11 else NOTHING, k * SLOW_NS)
    assert (events.corrected.tolist() == [0]) == is_found


@pytest.mark.parametrize("aside", [0.6, 0.75, 0.9])
def test_a_hard_turn_does_not_lead_to_a_part_beside_the_way(aside):
    """A leaf beside the way of a hidden target is smaller than the target."""
    corrected = {}
    for process_noise in ("adaptive", "continuous"):
        tracker = PointCloudTracker(config(process_noise))
        for k in range(12):
            place = np.array([8.0, 0.4 * k, 3.0])
            body = place + BODY if k < 11 else place + [0, 0, aside] + 0.3 * BODY
            events = tracker.new_point_cloud(body, NOTHING, k * SLOW_NS)
            tracker.new_detections(place[None] if k < 11 else NOTHING, k * SLOW_NS)
        corrected[process_noise] = events.corrected.tolist()
    assert corrected["adaptive"] == corrected["continuous"]
    assert aside < 0.9 or corrected["adaptive"] == []


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_hard_turns_do_not_depend_on_the_axes_or_on_others(axis):
    """The radius of the search bounds them along every axis, with and without a track far away."""
    found = set()
    for away in (None, 280.0):
        for back in (0.3, 0.6, 0.9, 1.2, 1.5, 1.9):
            tracker = PointCloudTracker(config("adaptive"))
            for k in range(12):
                place = np.array([8.0, 8.0, 8.0])
                place[axis] += 0.4 * k - back * (k == 11)
                other = np.empty((0, 3)) if away is None else np.array([[away, 8.0, 8.0 + 0.4 * k]])
                bodies = np.concatenate([place + BODY, *(one + BODY for one in other)])
                events = tracker.new_point_cloud(bodies, NOTHING, k * SLOW_NS)
                tracker.new_detections(np.concatenate([place[None], other]), k * SLOW_NS)
            found.add((back, 0 in events.corrected.tolist()))
    assert found == {
        (0.3, True),
        (0.6, True),
        (0.9, True),
        (1.2, False),
        (1.5, False),
        (1.9, False),
    }


def zigzag(scans):
    """Places at 5 Hz of two targets that turn by right angles, (N, 2, 3)."""
    step = np.array([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])
    one = np.cumsum(step[np.arange(scans) // 12 % 2], axis=0) + np.array([8.0, 0.0, 3.0])
    return np.stack([one, one * [1, -1, 1] + [0.0, -6.0, 1.0]], axis=1)


def test_hard_turns_agree_with_the_oracle():
    tracker, reference = PointCloudTracker(config("adaptive")), oracle.Tracker(config("adaptive"))
    rng = np.random.default_rng(0)
    tracker.new_point_cloud(np.zeros((1, 3)), NOTHING, -SLOW_NS)  # the local origin is the world's
    reference.new_point_cloud(np.zeros((1, 3)), NOTHING, -SLOW_NS)
    most = 0
    for k, places in enumerate(zigzag(75)):
        foreign = places[0] + rng.uniform(-1.5, 1.5, 3) + 0.3 * BODY
        shown = [place + BODY + rng.normal(size=BODY.shape) * 0.01 for place in places]
        cloud = np.concatenate([*shown, foreign][k % 7 == 5 :]).astype(np.float32)
        stamp, after_ns = k * SLOW_NS, np.linspace(0, 1e8, len(cloud)).astype(np.int64)
        delays = (after_ns * 1e-9).astype(np.float32).astype(float)
        tracker.new_point_cloud(cloud, NOTHING, stamp, point_time_ns=stamp + after_ns)
        reference.new_point_cloud(cloud, NOTHING, stamp, delays=delays)
        tracker.new_detections(places, stamp, covariance=np.repeat(SURE, 2, axis=0))
        reference.new_detections(places, NOTHING, stamp, covariance=np.repeat(SURE, 2, axis=0))
        tracks = tracker.tracks_at(stamp, confirmed=False)
        assert tracks.id.tolist() == [track.id for track in reference.tracks]
        for row, track in enumerate(reference.tracks):
            mean = np.r_[tracks.position[row], tracks.velocity[row], tracks.acceleration[row]]
            np.testing.assert_allclose(mean, track.x, rtol=0, atol=1e-8)
            np.testing.assert_allclose(tracks.covariance[row], track.P, rtol=0, atol=1e-7)
            most = max(most, track.n_turns)
    assert most >= 2
