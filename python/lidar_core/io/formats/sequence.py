"""Folders with one scan per file, ordered by number or time, with files of poses."""

import re
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_pose
from lidar_core.errors import FormatError, InputError
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.hints import recovering
from lidar_core.io.messages.cloud import CloudDecoder
from lidar_core.io.options import LONGEST, NS, ReadOptions
from lidar_core.io.poses.pose_files import read_matrices
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic
from lidar_core.messages import Message, Pose, Scan

FRAME, WORLD_FRAME = "lidar", "world"
MOST_NAMED = 10
"""Damaged files that a text names."""
ASSUMED = "assumed, scan_rate=RATE states another"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
_NANOSECONDS = re.compile(r"^\d{18,19}$")
_NUMBERED = re.compile(r"^(.*?)(\d+)(\D*)$")
_SECONDS = re.compile(r"^(\d{9,10})[._](\d{1,9})$")


class SequenceRecording(Recording):
    """One scan per file, ordered by number or time in the file names."""

    def __init__(self, path: Path, options: ReadOptions, files: list[Path]) -> None:
        super().__init__(path, options)
        self._stored = self._files = sorted(files, key=_natural_key)
        self._folder = path if path.is_dir() else path.parent
        self._stamps = self._find_stamps()
        self._kept = self._find_whole()
        self._files = [self._files[number] for number in self._kept]
        self._stamps = [self._stamps[number] for number in self._kept]
        self._topic = Topic(FRAME, self.format, "scan", len(self._files))
        self._decoder = CloudDecoder(FRAME, options, self.findings)
        self._poses = self._find_poses()

    def topics(self) -> list[Topic]:
        """The scans, and the poses if there are any."""
        poses = [Topic("poses", "poses.txt", "pose", len(self._poses))] if len(self._poses) else []
        return [self._topic, *poses]

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """One record per file, each after its pose."""
        pose_topic = self.topics()[-1]
        for number, (file, stamp_ns) in enumerate(zip(self._files, self._stamps, strict=True)):
            if len(self._poses) and (kinds is None or "pose" in kinds):
                yield Record(pose_topic, stamp_ns, partial(self._pose, number, stamp_ns))
            if kinds is None or "scan" in kinds:
                yield Record(self._topic, stamp_ns, partial(self._scan, file, stamp_ns))

    @abstractmethod
    def _rows(self, file: Path) -> NDArray[Any]:
        """Structured rows of one file, (N,) or (H, W)."""

    def _scan(self, file: Path, stamp_ns: int) -> list[Message]:
        limit = self.options.max_record_bytes
        check_size(
            str(file),
            file.stat().st_size,
            limit=limit,
            key="max_record_bytes",
            what="a file of bytes",
        )
        with self._reading_one():
            rows = self._rows(file)
        scan: Scan = self._decoder.scan(rows, stamp_ns, FRAME, place=str(file))
        return [scan]

    def _find_whole(self) -> list[int]:
        """Numbers of the files to read: with `recover`, those that are not damaged."""
        numbers = list(range(len(self._stored)))
        if not self.options.recover or len(self._stored) == 1:
            return numbers
        damaged = self._find_damaged()
        if not damaged:
            return numbers
        if len(damaged) == len(self._stored):
            raise FormatError(self._told(damaged))
        self.findings.note(f"{self._told(damaged)}; what cannot be read is left out")
        return [number for number in numbers if self._stored[number] not in damaged]

    def _find_damaged(self) -> dict[Path, FormatError]:
        """Files that cannot be read, with the reasons; reads all of them."""
        damaged = {}
        for file in self._stored:
            try:
                self._rows(file)
            except FormatError as error:
                damaged[file] = error
        return damaged

    def _told(self, damaged: dict[Path, FormatError]) -> str:
        """Error text that names the damaged files, with the reason of the first."""
        names = [file.name for file in damaged]
        more = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
        return (
            f"{self.path}: {len(names)} of {len(self._stored)} files cannot be read:"
            f" {', '.join(names[:MOST_NAMED] + more)}; the first: {next(iter(damaged.values()))}"
        )

    @contextmanager
    def _reading_one(self) -> Iterator[None]:
        """Let the error of one damaged file name all of them: a user fixes them together."""
        try:
            yield
        except FormatError as error:
            if len(self._stored) == 1:
                raise
            damaged = self._find_damaged()
            is_whole_left = len(damaged) < len(self._stored)
            cure = f"; {recovering(self.path)}" if is_whole_left else ""
            raise FormatError(self._told(damaged) + cure) from error

    def _pose(self, number: int, stamp_ns: int) -> list[Message]:
        return [Pose(stamp_ns, WORLD_FRAME, FRAME, self._poses[number], topic="poses")]

    def _find_stamps(self) -> list[int]:
        """Return the times of the scans [ns]: from times.txt, else from names, else by the rate."""
        for folder in (self._folder, self._folder.parent):
            if len(self._stored) > 1 and (folder / "times.txt").is_file():
                with reading(str(folder / "times.txt")):
                    seconds = np.loadtxt(folder / "times.txt", ndmin=1)
                self._expect_rows(folder / "times.txt", len(seconds))
                if not (np.abs(seconds) <= LONGEST).all():
                    raise FormatError(
                        f"{folder / 'times.txt'}: expected times in seconds, at most"
                        f" {LONGEST:.0f} s from 1970"
                    )
                return [round(float(value) * 1e9) for value in seconds]
        named = [_stamp_of(file) for file in self._stored]
        stamps = [stamp for stamp in named if stamp is not None]
        if len(stamps) == len(named):
            return stamps
        return self._assumed_stamps()

    def _assumed_stamps(self) -> list[int]:
        """Return times by the rate [ns], from the numbers in the names if they count scans."""
        rate, numbers = self.options.scan_rate, _numbers(self._stored)
        counted = list(range(len(self._stored)))
        steps = {b - a for a, b in pairwise(numbers)}
        is_stated = "scan_rate" in self.options.model_fields_set
        told = f"{rate:g} Hz " + ("as stated" if is_stated else ASSUMED)
        has_gaps = bool(steps - {1})
        if has_gaps:
            told += (
                f"; {len(numbers)} files have numbers from {numbers[0]} to {numbers[-1]}:"
                f" {numbers[-1] - numbers[0] + 1 - len(numbers)} numbers are missing"
            )
            # Numbers that count scans have neighbours; others may be times of any unit.
            if min(steps) == 1 and numbers[-1] - numbers[0] <= LONGEST * rate:
                counted = [number - numbers[0] for number in numbers]
                told += ", and the times have these gaps; a file times.txt can state other times"
            else:
                told += (
                    ", but the files are counted without gaps; if that is wrong, state their times"
                    " in a file times.txt"
                )
        if len(self._stored) > 1 and (has_gaps or not is_stated):
            self.findings.note(f"no times.txt and no times in the names: {told}")
        return [round(number * NS / rate) for number in counted]

    def _find_poses(self) -> NDArray[np.float64]:
        """Return the poses of the LiDAR from poses.txt; camera poses of KITTI need calib.txt."""
        none = np.empty((0, 4, 4))
        for folder in (self._folder, self._folder.parent):
            file = folder / "poses.txt"
            if len(self._stored) > 1 and file.is_file():
                break
        else:
            return none
        poses = read_matrices(file)
        self._expect_rows(file, len(poses))
        poses = poses[self._kept]
        camera_from_lidar = _calibration(file.parent / "calib.txt")
        if camera_from_lidar is None:
            return poses
        return np.asarray(np.linalg.inv(camera_from_lidar) @ poses @ camera_from_lidar)

    def _expect_rows(self, file: Path, count: int) -> None:
        if count != len(self._stored):
            raise FormatError(f"{file}: {count} lines for {len(self._stored)} scans")


def _natural_key(file: Path) -> tuple[int, str]:
    """Sort key that compares numbers by value, so that 2.pcd comes before 10.pcd."""
    digits = re.sub(r"\D", "", file.stem)
    return (int(digits) if digits else 0, file.name)


def _numbers(files: list[Path]) -> list[int]:
    """Return the numbers in names that differ only in an increasing number; else none."""
    found = [_NUMBERED.match(file.stem) for file in files]
    parts = [match.groups() for match in found if match]
    numbers = [int(number) for _, number, _ in parts]
    is_one_name = len({(before, after) for before, _, after in parts}) == 1
    is_increasing = all(a < b for a, b in pairwise(numbers))
    return numbers if len(numbers) == len(files) and is_one_name and is_increasing else []


def _stamp_of(file: Path) -> int | None:
    """Read the time [ns] in a file name: nanoseconds, or seconds with a fraction; else None."""
    if _NANOSECONDS.match(file.stem):
        stamp_ns = int(file.stem)
        return stamp_ns if stamp_ns <= LONGEST * NS else None  # else a number, not a time
    match = _SECONDS.match(file.stem)
    return int(match[1]) * 1_000_000_000 + int(match[2].ljust(9, "0")) if match else None


def _calibration(file: Path) -> NDArray[np.float64] | None:
    """Read `camera_from_lidar` (4, 4) of a KITTI calib.txt; None without one."""
    if not file.is_file():
        return None
    for line in file.read_text("utf-8", "replace").splitlines():
        key, _, rest = line.partition(":")
        if key.strip() in ("Tr", "Tr_velo_to_cam", "Tr_velo_cam"):
            with reading(str(file)):
                top = np.array(rest.split(), np.float64).reshape(3, 4)
            try:
                return as_pose(np.vstack([top, [0, 0, 0, 1]]), name="camera_from_lidar")
            except InputError as error:
                raise FormatError(f"{file}, line {key.strip()}: {error}") from error
    raise FormatError(f"{file}: no line Tr, which places the LiDAR in the camera's frame")
