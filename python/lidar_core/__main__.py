"""`python -m lidar_core`: the command `lidar-core`, where scripts are not on the path."""

from lidar_core.cli import main

if __name__ == "__main__":
    main()
