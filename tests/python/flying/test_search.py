"""Points that the map explains are not searched for clusters: all results stay the same."""

import numpy as np
import pytest
from helpers.flying_scenes import VLP_16, lidar, record_rounds

from golden.digest import Record
from golden.flying_replay import play_deskewed, yard
from lidar_core import PointClass
from lidar_core.flying import ClassifyConfig, ClusterConfig, FlyingConfig, FlyingObjectDetector
from lidar_core.sim import Circle, Hover, simulate

ROUND = Circle(center=(0.0, 0.0, 3.0), radius=2.0, speed=3.0)
STILL = Hover(position=(0.0, 0.0, 3.0))


def results(play, search, threads):
    record = Record()
    play(record, threads, FlyingConfig(classify=ClassifyConfig(search=search)))
    return record.entries()


def play(model, sensor, scans, *, sensors=("lidar",), rounds=1, classify=(), **changes):
    """A run over a simulated flight; several rounds fly it again, into the same map."""

    def run(record, threads, one):
        own = one.classify.model_copy(update=dict(classify))
        one = one.model_copy(update={**changes, "classify": own})
        detector = FlyingObjectDetector(one, threads=threads)
        made = list(simulate(yard(model, sensor, scans=scans), seed=1021))
        record_rounds(record, detector, made, rounds, sensors)

    return run


RUNS = {
    "moving sensor, moving targets": play(lidar(), ROUND, 24),
    "two sensors": play(lidar(), STILL, 20, sensors=("left", "right")),
    "sparse sensor": play(VLP_16, ROUND, 16),
    "deskewed": play_deskewed,
    "clusters by a fixed distance": play(lidar(), STILL, 16, cluster=ClusterConfig(max_angle=0)),
    "no groups": play(lidar(), STILL, 16, classify={"group_distance": None}),
    # Where a whole search is needed, it is made.
    "large clusters alone": play(lidar(), STILL, 16, cluster=ClusterConfig(min_points=4)),
    "voxels": play(lidar(), STILL, 16, cluster=ClusterConfig(of="voxels")),
    "map after the scan": play(lidar(), STILL, 16, classify={"map_state": "after_update"}),
}


@pytest.mark.ci_cases("moving sensor, moving targets", "two sensors", "voxels", "no groups")
@pytest.mark.parametrize("name", RUNS)
def test_detections_and_tracks_are_the_same(name):
    assert results(RUNS[name], "explained", 2) == results(RUNS[name], "full", 1)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["dense", "sparse"])
def test_detections_and_tracks_are_the_same_over_a_thousand_scans(name):
    run = play({"dense": lidar(), "sparse": VLP_16}[name], ROUND, 50, rounds=20)
    assert results(run, "explained", 2) == results(run, "full", 1)


@pytest.mark.parametrize("search", ["explained", "full"])
def test_targets_are_found_among_explained_points(search):
    scene = yard(lidar(), STILL, scans=24)
    detector = FlyingObjectDetector(FlyingConfig(classify=ClassifyConfig(search=search)))
    counts = np.zeros(4, int)
    for simulated in simulate(scene, seed=1022):
        frame = detector.process(
            simulated.scan.points,
            simulated.poses[0],
            stamp_ns=simulated.scan.stamp_ns,
            no_return=simulated.scan.no_return,
            directions=simulated.scan.directions,
        )
        counts += np.bincount(np.ravel(frame.point_class), minlength=4)
    assert counts[PointClass.FLYING] > 50
    assert counts[PointClass.BACKGROUND] > 100_000
