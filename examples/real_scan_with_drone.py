"""A simulated drone in a real scan: can the detector find it, and does it report nothing else?

The first scan of a recording is repeated with the sensor's noise; a sphere flies through space
that it shows as free. The scan itself, without the drone, is the map known beforehand.

Usage: python real_scan_with_drone.py RECORDING [--scans N] [--seed N] [--burn-in]
"""

import argparse
from itertools import islice

import numpy as np

from lidar_core import evaluation, io, sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.messages import Scan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording")
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--burn-in", action="store_true", help="no map beforehand")
    options = parser.parse_args()

    with io.open_recording(options.recording) as recording:
        scans = list(islice((item for item in recording if isinstance(item, Scan)), 1))
    config = FlyingConfig()
    detector = FlyingObjectDetector(config, threads=2)
    if not options.burn_in:
        points = scans[0].points.reshape(-1, 3)
        detector.set_occupied(points[np.isfinite(points).all(axis=1)])

    truth, tracks, speeds, times = [], [], [], []
    flight = sim.InsertedFlight(scans=options.scans)
    for number, made in enumerate(sim.with_target(scans, flight, seed=options.seed)):
        frame = detector.process(made)
        is_burn_in = number < config.seed.burn_in_scans
        truth.append(evaluation.truth_of(made, is_burn_in=is_burn_in))
        tracks.append(frame.tracks)
        speeds.append(float(np.linalg.norm(made.truth.velocity)))
        times.append(sum(frame.timing_ms.values()))

    found = evaluation.estimates_of_tracks(tracks)
    scores = evaluation.score_tracks(found, evaluation.joined(truth))
    print(f"drone: {min(speeds):.1f} to {max(speeds):.1f} m/s")
    print(f"sightings: {scores.n_eligible} in {options.scans} scans")
    print(f"recall of tracks: {scores.recall:.3f}")
    print(f"mean position error: {scores.mean_error:.3f} m")
    print(f"other tracks: {len(scores.false_ids)}")
    print(f"time per scan: {np.mean(times):.0f} ms")


if __name__ == "__main__":
    main()
