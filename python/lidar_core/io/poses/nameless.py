"""Search for the frame of poses without child frame, as in PoseStamped and some odometry."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError
from lidar_core.io.poses.tf_buffer import NoTransformError, TransformBuffer
from lidar_core.io.rotations import angles_from_matrix
from lidar_core.messages import Pose

SAME_PLACE, SAME_TURN = 0.01, 0.01
"""How far two frames that are one may seem apart [m, rad]: stamps and rounding."""
LOOKED_AT = 16  # poses that are compared


class UnclearCarrierError(ConfigError):
    """Several frames carry a sensor, and the recording does not state to which one poses belong.

    Attributes
    ----------
    mountings : list of str
        Values of the option `mounting` that resolve it, the nearest frame first.
    """

    def __init__(self, text: str, mountings: list[str]) -> None:
        super().__init__(text)
        self.mountings = mountings


def carrier_of(
    frame: str, poses: Sequence[Pose], others: Iterable[Pose], mountings: Iterable[Pose], topic: str
) -> str:
    """Return the frame that `poses` without a child frame describe.

    Evidence in this order: a stated mounting, unless its frame moves differently; a transform with
    the same motion; the frame that the sensor is mounted on. Without any evidence the poses are
    those of the sensor.

    Parameters
    ----------
    frame : str
        Frame of the sensor.
    poses : sequence of Pose
        Poses of one topic, without child frame.
    others : iterable of Pose
        Transforms of the recording.
    mountings : iterable of Pose
        Mountings of sensors that the user stated.
    topic : str
        Name of their topic, for errors.

    Raises
    ------
    UnclearCarrierError
        Several frames carry the sensor, and the recording does not state which one is meant.
    ConfigError
        The sensor does not move in the frame of the poses.
    """
    known = list(others)
    stated = {item.child_frame_id: item.frame_id for item in mountings}
    same = same_movement(poses, _buffer(item for item in known if not item.is_static))
    moving = {item.child_frame_id for item in known if not item.is_static}
    if frame in stated and (same is None or stated[frame] not in moving):
        return stated[frame]
    if same is not None:
        return same
    carriers = _carriers(frame, known)
    chain = _buffer(item for item in known if item.is_static)
    if parents := {item.frame_id for item in poses} & set(carriers):
        raise ConfigError(
            f"odom: poses of {topic!r} are in frame {min(parents)!r}, but static transforms of the"
            f" recording fix {frame!r} in that frame, so these poses are not the sensor's; leave"
            ' odom out and use pose="static"'
        )
    if not carriers:
        return frame
    sensor = [chain.lookup(carrier, frame, [0])[0] for carrier in carriers]
    if all(np.allclose(one, sensor[0], atol=1e-9) for one in sensor):
        return carriers[0]
    if carriers[-1] in moving:  # only the top of what is mounted together can move
        return carriers[-1]
    texts = [
        _mounting(carrier, frame, matrix) for carrier, matrix in zip(carriers, sensor, strict=True)
    ]
    choices = " or ".join(f"mounting='{text}'" for text in texts)
    raise UnclearCarrierError(
        f"odom: poses of {topic!r} do not name their frame; it may be"
        f" {' or '.join(carriers)}, which carry {frame!r}: select one with {choices}",
        texts,
    )


def _buffer(poses: Iterable[Pose]) -> TransformBuffer:
    buffer = TransformBuffer(max_gap=1.0, max_extrapolation=0.01)
    for pose in poses:
        buffer.add(pose)
    return buffer


def _mounting(parent: str, frame: str, matrix: NDArray[np.float64]) -> str:
    """Text of the option that states a mounting."""
    values = (*matrix[:3, 3], *angles_from_matrix(matrix[:3, :3]))
    numbers = " ".join(f"{round(float(value), 9) + 0.0:.9g}" for value in values)
    return f"{parent} {frame} {numbers}"


def _carriers(frame: str, known: Iterable[Pose]) -> list[str]:
    """Frames on which `frame` is mounted, the nearest first."""
    parents = {item.child_frame_id: item.frame_id for item in known if item.is_static}
    found: list[str] = []
    while frame in parents and parents[frame] not in found:
        frame = parents[frame]
        found.append(frame)
    return found


def same_movement(poses: Sequence[Pose], transforms: TransformBuffer) -> str | None:
    """Return the frame whose `transforms` have the motion of `poses`; None for none, or several."""
    looked_at = poses[:: max(1, len(poses) // LOOKED_AT)]
    parents = {item.frame_id for item in looked_at}
    found = [
        child
        for (parent, child), is_static in transforms.edges().items()
        if not is_static
        and child
        and parent in parents
        and _agree(transforms, parent, child, looked_at)
    ]
    return found[0] if len(found) == 1 else None


def _agree(buffer: TransformBuffer, parent: str, child: str, poses: Sequence[Pose]) -> bool:
    compared = 0
    for pose in poses:
        try:
            (matrix,) = buffer.lookup(parent, child, [pose.stamp_ns])
        except NoTransformError:
            continue
        compared += 1
        turn = matrix[:3, :3].T @ pose.matrix[:3, :3]
        cosine = (np.trace(turn) - 1) / 2
        is_near = np.linalg.norm(matrix[:3, 3] - pose.matrix[:3, 3]) <= SAME_PLACE
        if not is_near or cosine < np.cos(SAME_TURN):
            return False
    return compared > 0
