"""How well detectors estimate circles; with 50000 as argument, the table of docs/training.md."""

import sys

import numpy as np

from lidar_core.circles import CircleDetector, DatasetConfig, make_samples

SEED, ROWS = 0, 2_000


def main(count: int) -> None:
    """Print the errors of cnn and ml on so many circles."""
    config = DatasetConfig.continuous(circles=count)
    scanner = config.scanner
    samples = make_samples(config, count=count, seed=SEED)
    scans = samples.scans(scanner)
    whole = samples.is_whole(scanner)
    groups = {
        "all": np.ones(count, bool),
        "wholly visible, 4 hits or more": whole & (samples.n_hits >= 4),
        "cut": ~whole,
    }
    for name in ("cnn", "ml"):
        detector = CircleDetector(name)
        found = [
            detector.detect(scans[start : start + ROWS], scanner.bearings())
            for start in range(0, count, ROWS)
        ]
        errors = np.concatenate([np.asarray(part) for part in found]) - samples.circles
        covariance = np.concatenate([part.covariance for part in found])
        scaled = np.linalg.solve(covariance, errors[:, :, None])[:, :, 0]
        nees = (errors * scaled).sum(axis=1).mean()
        for group, chosen in groups.items():
            of_sample = np.abs(errors[chosen]).mean(axis=1)
            print(
                f"{name}, {group}: MSE {np.square(errors[chosen]).mean():.3g} m^2,"
                f" MAE {of_sample.mean():.4f} m, p99 {np.quantile(of_sample, 0.99):.3f} m"
            )
        print(f"NEES of {name}: {nees:.2f}, 3 is right")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5_000)
