"""Real sequences of scans in which nothing flies, as drivers deliver them, each with its poses.

They are stored as archives in the folder of recordings. An archive is unpacked once into the folder
for temporary files, under its hash.
"""

import hashlib
import os
import shutil
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, LimitError
from lidar_core.io import PosedScan, ReadOptions, open_recording, posed_scans
from lidar_core.io.recording import Recording
from lidar_core.io.records import SCAN_KINDS
from lidar_core.messages import Scan
from lidar_core.reproduce.recordings import recording

ROOT = "3d/sequences"
LARGEST = 2**30
"""Bytes that an archive may unpack to."""
CSV_ROW = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")]
)
LAYOUT = 2
"""Of an unpacked folder; another number unpacks again."""


@dataclass(frozen=True, slots=True)
class RealSequence:
    """Scans of one real sensor.

    Attributes
    ----------
    name : str
        Name in rows of results.
    source : str
        Archive, file or folder, within the folder of recordings.
    pose : str
        static, kiss for KISS-ICP, or a poses file within the folder of recordings.
    spacing : float, optional
        Time between two files of a folder [s]; None: that of the reader, which follows the numbers
        in their names at 10 Hz.
    range_max : float
        Largest range in the data sheet of the sensor [m].
    azimuth_deg, elevation_deg : tuple of float
        Field of view, by its data sheet: least and greatest [deg].
    labels : str, optional
        Archive with labelled boxes of every scan, within the folder of recordings.
    is_printable : bool
        True if the licence allows published numbers.
    """

    name: str
    source: str
    pose: str = "static"
    spacing: float | None = 0.1
    range_max: float = 100.0
    azimuth_deg: tuple[float, float] = (-180.0, 180.0)
    elevation_deg: tuple[float, float] = (-15.0, 15.0)
    labels: str | None = None
    is_printable: bool = True

    @property
    def files(self) -> tuple[str, ...]:
        """Recordings that the sequence needs, see `recordings.recording`."""
        of_poses = () if self.pose in ("static", "kiss") else (self.pose,)
        return (self.source, *of_poses, *([self.labels] if self.labels else []))


SEQUENCES = (
    RealSequence(
        "radiate_tiny_foggy",
        f"{ROOT}/radiate_tiny_foggy/velo_lidar_and_gps.tar.xz",
        "kiss",
        elevation_deg=(-30.67, 10.67),
        is_printable=False,
    ),
    RealSequence(
        "street_128_labelled",
        f"{ROOT}/street_128_labelled/lidar_rounded_000000-000029.tar.xz",
        "kiss",
        range_max=200.0,
        elevation_deg=(-25.0, 15.0),
        labels=f"{ROOT}/street_128_labelled/labels_000000-000029.tar.xz",
    ),
    RealSequence(
        "livox_hap_outdoor",
        f"{ROOT}/livox_hap_outdoor/scans.tar.xz",
        spacing=0.5,
        range_max=150.0,
        azimuth_deg=(-60.0, 60.0),
        elevation_deg=(-12.5, 12.5),
    ),
    RealSequence(
        "livox_horizon_sway",
        f"{ROOT}/livox_horizon_sway/scans.tar.xz",
        range_max=90.0,
        azimuth_deg=(-40.85, 40.85),
        elevation_deg=(-12.55, 12.55),
    ),
    RealSequence("rs16_office", f"{ROOT}/rs16_office/scans.tar.xz", spacing=None, range_max=150.0),
)
"""Sequences of 20 scans and more, in which nothing flies."""

SHORT_SEQUENCES = (
    RealSequence("robosense_placeholder", f"{ROOT}/robosense_placeholder/100002.pcd"),
    RealSequence(
        "ouster_lb_n3",
        "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap",
        "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt",
        range_max=200.0,
    ),
    RealSequence("ouster_10_scans", "3d/ouster/osf_fw_3.2_10scans.osf"),
    RealSequence("ouster_os0_128", "3d/ouster/OS-0-128-U1_v2.3.0_1024x10.pcap"),
    RealSequence("ouster_os2_128", "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap", range_max=200.0),
    RealSequence("velodyne_hdl32", "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap"),
    RealSequence("velodyne_vlp16", "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap"),
)
"""Recordings of 1 to 10 scans."""


def sequence_named(name: str) -> RealSequence:
    """Return the sequence of this name."""
    return {one.name: one for one in (*SEQUENCES, *SHORT_SEQUENCES)}[name]


def sequence_scans(sequence: RealSequence, *, static: bool = False) -> Iterator[PosedScan[Scan]]:
    """Scans of a sequence with their poses, as `lidar-core detect` gives them to the detector.

    Parameters
    ----------
    sequence : RealSequence
        Sequence to read.
    static : bool
        Ignore the poses, as if the sensor stood still.

    Raises
    ------
    ConfigError
        The folder of recordings is not named, or does not hold the sequence.
    MissingExtraError
        Poses by KISS-ICP need the extra `odometry`.
    """
    path = _unpack(recording(sequence.source))
    with open_recording(path, ReadOptions()) as opened:
        times = _times(sequence, opened)
        for item in posed_scans(opened, pose=_poses(sequence, static)):
            # files of these sequences state no times of points, which would have to move, too
            stamp_ns = times.get(item.scan.stamp_ns, item.scan.stamp_ns)
            yield replace(item, scan=replace(item.scan, stamp_ns=stamp_ns))


def _times(sequence: RealSequence, opened: Recording) -> dict[int, int]:
    """New stamps of the scans [ns] by the reader's stamps, for a folder that states no times."""
    if sequence.spacing is None or not opened.path.is_dir():
        return {}
    own = (record.time_ns for record in opened.records(SCAN_KINDS))
    return {stamp: round(number * sequence.spacing * 1e9) for number, stamp in enumerate(own)}


def _poses(sequence: RealSequence, static: bool) -> str:
    if static:
        return "static"
    is_named = sequence.pose in ("static", "kiss")
    return sequence.pose if is_named else str(recording(sequence.pose))


def _unpack(path: Path) -> Path:
    """Return the folder of an archive's unpacked scans; for other recordings, `path` itself."""
    if not path.name.endswith(".tar.xz"):
        return path
    return _unpacked(path, _gather)


def unpack_files(path: Path, suffix: str) -> list[Path]:
    """Return the files of an archive whose names end with `suffix`, unpacked once."""

    def gather(path: Path, whole: Path, target: Path) -> None:
        for file in whole.rglob(f"*{suffix}"):
            shutil.move(file, target / file.name)

    return [*_unpacked(path, gather).iterdir()]


def _unpacked(path: Path, gather: Callable[[Path, Path, Path], None]) -> Path:
    """Return the folder with what `gather` takes of an archive.

    `gather` is called with the archive, the folder of its unpacked files and an empty folder.
    """
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:20]
    target = _cache() / f"{path.parent.name}-{digest}-{LAYOUT}"
    if target.is_dir():
        return target
    with tempfile.TemporaryDirectory(dir=_cache()) as name:
        whole, taken = Path(name) / "whole", Path(name) / "taken"
        _extract(path, whole)
        taken.mkdir()
        gather(path, whole, taken)
        try:
            taken.rename(target)
        except OSError:
            if not target.is_dir():  # else another process was faster
                raise
    return target


def _cache() -> Path:
    """Cache folder of this user for unpacked files.

    Raises
    ------
    FormatError
        The folder belongs to another user.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"lidar-core-sequences-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != user:
        raise FormatError(f"{folder}: belongs to another user; TMPDIR names another place")
    return folder


def _extract(path: Path, folder: Path) -> None:
    """Unpack the plain files of an archive.

    Raises
    ------
    FormatError
        The archive is damaged, or has members outside of the folder.
    LimitError
        The unpacked files are too large.
    """
    try:
        with tarfile.open(path) as archive:
            size = 0
            for member in archive:
                size += member.size
                if size > LARGEST:
                    raise LimitError(f"{path}: unpacks to more than {LARGEST} bytes")
                if member.isfile():
                    _write(archive, member, folder)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise FormatError(f"{path}: cannot be unpacked: {error}") from error


def _write(archive: tarfile.TarFile, member: tarfile.TarInfo, folder: Path) -> None:
    # Extraction filters came with Python 3.11.4; Debian 12 has 3.11.2.
    target = (folder / member.name).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise tarfile.ExtractError(f"{member.name!r} reaches out of the folder")
    content = archive.extractfile(member)
    if content is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("wb") as file:
            shutil.copyfileobj(content, file)


def _gather(path: Path, whole: Path, scans: Path) -> None:
    """Move the scans of an unpacked archive into one folder, tables as PCD files."""
    tables = sorted(whole.rglob("velo_lidar/*.csv"))
    for table in tables:
        _write_rows(scans / f"{table.stem}.pcd", np.loadtxt(table, CSV_ROW, delimiter=","))
    clouds = sorted(whole.rglob("*.pcd"))
    for cloud in clouds:
        if _can_be_read(cloud):
            shutil.move(cloud, scans / cloud.name)
    if not tables and not clouds:
        raise FormatError(f"{path}: expected scans as .pcd or velo_lidar/*.csv, found none")


def _can_be_read(cloud: Path) -> bool:
    """Return whether a file is complete, not cut by a recording that stopped within a scan."""
    try:
        with open_recording(cloud, ReadOptions()) as opened:
            return any(True for _ in posed_scans(opened, pose="static"))
    except FormatError:
        return False


def _write_rows(path: Path, rows: NDArray[np.void]) -> None:
    """Write rows as a binary PCD file with all their fields."""
    kinds = {"f": "F", "u": "U"}
    types = [CSV_ROW[name] for name in CSV_ROW.names or ()]
    header = "\n".join(
        [
            "VERSION .7",
            "FIELDS " + " ".join(CSV_ROW.names or ()),
            "SIZE " + " ".join(str(one.itemsize) for one in types),
            "TYPE " + " ".join(kinds[one.kind] for one in types),
            "COUNT " + " ".join("1" for _ in types),
            f"WIDTH {len(rows)}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {len(rows)}",
            "DATA binary\n",
        ]
    )
    path.write_bytes(header.encode("ascii") + rows.tobytes())
