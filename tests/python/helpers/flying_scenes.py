"""Small scenes for the tests of the detector, and how their scans go into it."""

from functools import cache

import numpy as np

from lidar_core.sim import (
    Body,
    Box,
    Cylinder,
    Hover,
    LidarModel,
    Plane,
    Scene,
    Sphere,
    Spinning,
    Target,
    Waypoints,
    simulate,
)

VLP_16 = LidarModel.preset("vlp-16", ideal=True)
RADIUS = 0.325  # of the balls that stand for drones [m]


def lidar(rows=48, columns=360, *, half_deg=22.5, **changes):
    """A spinning LiDAR with few rays."""
    elevations = tuple(np.linspace(half_deg, -half_deg, rows).tolist())
    return LidarModel(pattern=Spinning(elevations_deg=elevations, columns=columns), **changes)


def wall(position, size):
    return Body(shape=Box(size=size), position=position)


def drone(*places, seconds=2.0):
    """A ball that flies from place to place at constant intervals."""
    if len(places) == 1:
        return Target(shape=Sphere(radius=RADIUS), motion=Hover(position=places[0]))
    times = tuple(np.linspace(0, seconds, len(places)).tolist())
    return Target(shape=Sphere(radius=RADIUS), motion=Waypoints(times=times, positions=places))


YARD = (
    Body(shape=Plane(size=(60.0, 60.0))),
    wall((12.0, 0.0, 3.0), (1.0, 20.0, 6.0)),
    wall((0.0, -11.0, 3.0), (20.0, 1.0, 6.0)),
    Body(shape=Cylinder(radius=0.3, height=6.0), position=(-7.0, 3.0, 3.0)),
)


def yard(*targets, sensor=None, scans=20, bodies=YARD, **changes):
    """Ground, two walls, a pole, open sky on two sides; the sensor at (0, 0, 3)."""
    return Scene(
        bodies=bodies,
        targets=targets,
        lidar=changes.pop("lidar", lidar()),
        sensor=sensor if sensor is not None else Hover(position=(0.0, 0.0, 3.0)),
        scans=scans,
        **changes,
    )


@cache
def scans_of(scene, seed=0):
    """All scans of a scene."""
    return tuple(simulate(scene, seed=seed))


def feed(detector, simulated, **changes):
    """Process a simulated scan, deskewed; `changes` to the arguments."""
    scan = simulated.scan
    arguments = {
        "points_lidar": scan.points,
        "world_from_lidar": simulated.poses,
        "stamp_ns": scan.stamp_ns,
        "no_return": scan.no_return,
        "directions": scan.directions,
        "point_time_ns": scan.point_time_ns,
        "pose_stamps_ns": simulated.pose_stamps_ns,
    }
    return detector.process(**arguments | changes)


TEXTS = frozenset({"reason", "rejected"})


def record_rounds(record, detector, made, rounds, sensors):
    """Process simulated scans several times, by sensors in turn, and record the results."""
    for number in range(rounds * len(made)):
        simulated = made[number % len(made)]
        frame = detector.process(
            simulated.scan.points,
            simulated.poses[0],
            stamp_ns=number * 100_000_000,
            no_return=simulated.scan.no_return,
            directions=simulated.scan.directions,
            sensor=sensors[number % len(sensors)],
        )
        record.add("frame", frame, skip=TEXTS)
    record.add("occupied", detector.occupied_points())
    record.add("n_observed", detector.n_observed)
