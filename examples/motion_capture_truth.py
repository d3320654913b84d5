"""Poses of an object in a recording, as the truth for `lidar-core evaluate`.

python examples/motion_capture_truth.py RECORDING TOPIC RUN TRUTH.csv
lidar-core evaluate RUN TRUTH.csv

TOPIC is the stream of the object's poses, RUN the folder of `lidar-core circles` or `detect` on
RECORDING. The truth has a row per scan of the run, between the poses before and after it.
"""

import csv
import sys
from pathlib import Path

import numpy as np

import lidar_core as lc
from lidar_core.errors import InputError
from lidar_core.io import TransformBuffer, open_recording, read_columns
from lidar_core.run_folder import table_in

COLUMNS = ("t_ns", "target_id", "x", "y", "z", "vx", "vy", "vz")
NAMELESS = "world"
"""Stands for a frame without a name, which no transform may have."""
STEP_NS = 50_000_000
"""Half of the time over which velocities are taken [ns]."""


def buffer_of(recording: Path, topic: str) -> tuple[TransformBuffer, str]:
    """Poses of one topic, and the frame they are in."""
    buffer, frames, topics = TransformBuffer(max_gap=0.5, max_extrapolation=0.1), set(), set()
    with open_recording(recording) as opened:
        for found, pose in opened.poses():
            topics.add(found.name)
            if found.name == topic:
                frame = pose.frame_id or NAMELESS  # motion capture often names no frame
                frames.add(frame)
                buffer.add(lc.messages.Pose(pose.stamp_ns, frame, "object", pose.matrix))
    if not frames:
        there = ", ".join(sorted(topics)) or "none"
        raise InputError(f"{recording}: no poses on topic {topic!r}; topics with poses: {there}")
    if len(frames) > 1:
        raise InputError(f"{recording}: {topic!r} is in several frames: {sorted(frames)}")
    return buffer, frames.pop()


def truth_rows(buffer: TransformBuffer, frame: str, stamps: list[int]) -> list[list[float]]:
    """A row of `COLUMNS` per stamp inside the poses' time."""
    rows: list[list[float]] = []
    for stamp in stamps:
        try:
            around = buffer.lookup(frame, "object", [stamp - STEP_NS, stamp, stamp + STEP_NS])
        except lc.io.NoTransformError:
            continue
        before, now, after = around[:, :3, 3]
        velocity = (after - before) / (2 * STEP_NS * 1e-9)
        rows.append([stamp, 1, *now.tolist(), *velocity.tolist()])
    return rows


def main() -> None:
    """Write the table."""
    recording, topic, run, truth = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), sys.argv[4]
    timing = table_in(run, "timing")
    if timing is None:
        raise InputError(f"{run}: no run folder")
    stamps = np.unique(read_columns(timing)["t_ns"]).tolist()
    rows = truth_rows(*buffer_of(recording, topic), stamps)
    with open(truth, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    print(f"{truth}: {len(rows)} of {len(stamps)} scans")


if __name__ == "__main__":
    main()
