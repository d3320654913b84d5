"""Conversion of frames of Ouster sensors to scans and poses."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.ouster.packets import Frame
from lidar_core.io.ouster.sensor import MILLIMETRE, Sensor
from lidar_core.messages import Message, Pose, Scan

SENSOR_FRAME, BODY_FRAME, WORLD_FRAME = "os_sensor", "body", "world"
COLUMNS_PER_POSE = 16  # a pose every 1.6 ms at 1024 columns and 10 Hz
NO_RETURN = "zero: range 0 in a received column"
POINT_TIME = "of each column, by the sensor's clock"


def scan_of(
    sensor: Sensor, frame: Frame, *, topic: str, frame_id: str, destagger: bool
) -> Scan | None:
    """Scan of a frame, organised, in the sensor's frame; None if no column was received."""
    received = frame.is_received
    if not received.any():
        return None
    beams = sensor.beams
    stamp_ns = int(frame.stamps_ns[received].min())
    stamps = np.where(received, frame.stamps_ns, stamp_ns)
    shape = frame.ranges.shape
    points = (frame.ranges[..., None] * MILLIMETRE * beams.directions + beams.offsets).astype(
        np.float32
    )
    is_empty = frame.ranges == 0
    points[is_empty] = np.nan
    columns: dict[str, NDArray[Any]] = {
        "points": points,
        # The first return of a beam without second return may have hit something.
        "no_return": is_empty & received & (not frame.is_second),
        "directions": beams.directions.astype(np.float32),
        "times": np.broadcast_to(stamps, shape),
        "ring": np.broadcast_to(np.arange(sensor.rows, dtype=np.uint16)[:, None], shape),
    }
    if frame.reflectivity is not None:
        columns["intensity"] = frame.reflectivity.astype(np.float32)
    if destagger:
        columns = {name: shift_rows(image, sensor.shifts) for name, image in columns.items()}
    flat = {name: np.ascontiguousarray(image) for name, image in columns.items()}
    return Scan(
        stamp_ns=stamp_ns,
        points=flat["points"],
        frame_id=frame_id,
        no_return=flat["no_return"].reshape(-1),
        directions=flat["directions"].reshape(-1, 3),
        point_time_ns=flat["times"].reshape(-1),
        intensity=flat["intensity"].reshape(-1) if "intensity" in flat else None,
        ring=flat["ring"].reshape(-1),
        topic=topic,
    )


def told_returns(frame: Frame) -> str:
    """Return a note about which of two returns is read."""
    if frame.is_second:
        return "second returns are read, not the first"
    return "second returns are not read (returns='second' of open_recording reads them instead)"


def poses_of(sensor: Sensor, frame: Frame, *, topic: str, frame_id: str) -> list[Message]:
    """Mounting of the sensor, and the body's poses if the file contains any."""
    valid = np.flatnonzero(frame.is_received)
    stamps = frame.stamps_ns
    mounting = sensor.body_from_sensor.copy()
    result: list[Message] = [
        Pose(int(stamps[valid[0]]), BODY_FRAME, frame_id, mounting, is_static=True, topic=topic)
    ]
    matrices = frame.world_from_body
    if matrices is None or np.array_equal(matrices, np.broadcast_to(np.eye(4), matrices.shape)):
        return result
    chosen = np.unique(np.append(valid[::COLUMNS_PER_POSE], valid[-1]))
    result += [
        Pose(int(stamps[column]), WORLD_FRAME, BODY_FRAME, matrices[column].copy(), topic=topic)
        for column in chosen
    ]
    return result


def shift_rows(image: NDArray[Any], shifts: NDArray[np.int64]) -> NDArray[Any]:
    """Return `image` with every row rolled by its shift, so that columns share an azimuth."""
    width = image.shape[1]
    columns = (np.arange(width)[None, :] - shifts[:, None]) % width
    shifted: NDArray[Any] = image[np.arange(image.shape[0])[:, None], columns]
    return shifted
