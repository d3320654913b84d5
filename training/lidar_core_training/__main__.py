"""`python -m lidar_core_training`: a run without pictures, for `torchrun` and long jobs."""

import argparse
from pathlib import Path

from lidar_core_training.config import TrainConfig
from lidar_core_training.train import train


def main() -> None:
    """Train as a file says."""
    parser = argparse.ArgumentParser(prog="python -m lidar_core_training", description=__doc__)
    parser.add_argument("-c", "--config", type=Path, required=True, help="TOML of a TrainConfig")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the run")
    given = parser.parse_args()
    train(TrainConfig.read(given.config), given.output)


if __name__ == "__main__":
    main()
