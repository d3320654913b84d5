"""Score the detector on ten streets: what `lidar-core demo` measures, for seeds 0 to 9.

python examples/score_seeds.py [SEED ...]
"""

import sys

from lidar_core import evaluation, flying, sim
from lidar_core.evaluation import DetectionScores, TrackScores


def score(
    seed: int, *, scans: int = 60, config: flying.FlyingConfig | None = None
) -> tuple[TrackScores, DetectionScores]:
    """Fly one street; scores of the tracks and of the detections."""
    detector = flying.FlyingObjectDetector(config, threads=2)
    burn_in = detector.config.seed.burn_in_scans
    truth, frames = [], []
    for k, made in enumerate(
        sim.simulate(sim.scenes.demo(seed, scans=scans), seed=seed, threads=2)
    ):
        truth.append(evaluation.truth_of(made, is_burn_in=k < burn_in))
        frames.append(detector.process(made))
    report = evaluation.evaluate(
        evaluation.joined(truth),
        tracks=evaluation.estimates_of_tracks(frame.tracks for frame in frames),
        detections=evaluation.estimates_of_detections(frames),
    )
    return report.tracks, report.detections


def main() -> None:
    """Print one line per seed, then the sums."""
    found = eligible = false_tracks = 0
    error = 0.0
    for seed in [int(word) for word in sys.argv[1:]] or range(10):
        tracks, detections = score(seed)
        found, eligible = found + tracks.n_found, eligible + tracks.n_eligible
        error += (tracks.mean_error or 0.0) * tracks.n_found
        false_tracks += len(tracks.false_ids)
        print(
            f"seed {seed}: tracks found {tracks.n_found} of {tracks.n_eligible},"
            f" mean error {tracks.mean_error:.3f} m, false tracks {len(tracks.false_ids)},"
            f" longest gap {max(tracks.longest_gap.values(), default=0.0):.1f} s;"
            f" detections found {detections.n_found}, false {detections.n_false}"
        )
    print(
        f"all: recall of tracks {found / eligible:.4f}, mean error {error / found:.3f} m,"
        f" false tracks {false_tracks}"
    )


if __name__ == "__main__":
    main()
