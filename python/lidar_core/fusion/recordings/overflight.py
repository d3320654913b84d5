"""Measurements of a simulated drone, converted to the level frame, and written as a table."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_core.fusion.recordings.columns.cells import POSITION, VELOCITY
from lidar_core.fusion.recordings.table import VALUES
from lidar_core.fusion.space import LevelSight, level_sight
from lidar_core.io.tables.long_table import write_long_table

if TYPE_CHECKING:
    from lidar_core.sim import Overflown

_COLUMNS: dict[str, type] = {
    "t_ns": int,
    **{name: float for names in VALUES.values() for name in names},
    **dict.fromkeys((*POSITION, *VELOCITY), float),
}


def level_overflight(made: "Overflown") -> LevelSight:
    """Level the measurements of both sensors of a simulated drone, by the measured angles.

    Parameters
    ----------
    made : Overflown

    Returns
    -------
    LevelSight
        Positions of the LiDAR as range and bearing, without a range rate (0).
    """
    x, y, _ = made.values.T
    far, config = np.hypot(x, y), made.config
    lidar = np.stack([far, np.arctan2(y, x), 0 * far], axis=1)
    std = np.stack([0 * far + config.lidar_std, config.lidar_std / far, 0 * far + 1], axis=1)
    kind = made.is_lidar[:, None]
    return level_sight(
        np.where(kind, lidar, made.values),
        made.swivel,
        made.pitch,
        std=np.where(kind, std, config.radar_std),
        swivel_std=config.angle_std[0],
        pitch_std=config.angle_std[1],
    )


def write_overflight(path: str | Path, made: "Overflown") -> None:
    r"""Write level measurements of a simulated drone as a table, for `lidar-core fuse`.

    Parameters
    ----------
    path : str or Path
        CSV or Parquet file to write: LiDAR and radar in turn; turn rate, pose
        of the drone, and the truth in every row.
    made : Overflown

    Examples
    --------
    >>> from lidar_core.sim import Overflight, overfly
    >>> path = getfixture("tmp_path") / "drone.csv"
    >>> write_overflight(path, overfly(Overflight(seconds=1.0), seed=0))
    >>> path.read_text().count("\n")
    21
    """
    far, bearing, rate = level_overflight(made).values.T
    kind = made.is_lidar[:, None]
    lidar = np.stack([far * np.cos(bearing), far * np.sin(bearing)], axis=1)
    radar = np.stack([far, bearing, rate], axis=1)
    seen = [np.where(kind, lidar, np.nan), np.where(kind, np.nan, radar)]
    drone = np.column_stack([made.gyro, made.drone[:, :2], made.yaw])
    true = [made.position[:, :2], made.velocity[:, :2]]
    rows = zip(made.stamps_ns.tolist(), np.hstack([*seen, drone, *true]).tolist(), strict=True)
    write_long_table(path, _COLUMNS, [[stamp, *row] for stamp, row in rows])
