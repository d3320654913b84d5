"""Which reader a path needs, told by its content rather than by its name where possible."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lidar_core.errors import FormatError, meant
from lidar_core.files import check_regular, check_regular_or_folder
from lidar_core.io.formats.unpacked import PACKED, UnpackedRecording
from lidar_core.io.hints import hint_for
from lidar_core.io.options import ReadOptions
from lidar_core.io.recording import Recording

KNOWN = (
    "ROS 1 .bag, ROS 2 folder or .db3, .mcap, Ouster .pcap with .json or .osf, Velodyne .pcap or"
    " .pcapng, .pcd, .ply, .las or .laz file or folder, KITTI .bin folder, CARMEN .clf or .clf.bz2,"
    " .npz file or folder"
)

ROS2 = (".db3",)
CHAINS = ((".mcap",), (".npz",))
SEQUENCES = ((".pcd",), (".las", ".laz"), (".ply",), (".bin",))
ALONE = ((".bag",), (".clf", ".clf.bz2"), (".osf",), (".pcap", ".pcapng"))
KINDS = (ROS2, PACKED, *CHAINS, *SEQUENCES, *ALONE)
"""What a folder may hold, by the ends of names: files of one recording, one after the other, a
scan each, or a recording each."""
MOST_FOLDERS = 12
"""Folders that are named where one without a recording was given."""


def open_recording(
    path: str | Path, options: ReadOptions | None = None, **values: Any
) -> Recording:
    """Open a recording of any supported format.

    Parameters
    ----------
    path : str or Path
        File or folder.
    options : ReadOptions, optional
        How to read it.
    **values
        Single fields of `ReadOptions`; they override `options`.

    Returns
    -------
    recording : Recording
        Iterates over `Scan` and `Pose` in time order; a context manager.

    Raises
    ------
    FormatError
        Unknown or broken format; the text names the file and what is wrong.
    LimitError
        A record is larger than the options allow.
    MissingExtraError
        The format needs a package that is not installed.
    FileNotFoundError
        There is no such file.

    Examples
    --------
    >>> with open_recording("flight.mcap") as recording:  # doctest: +SKIP
    ...     scans = [message for message in recording if isinstance(message, Scan)]
    """
    given = options.model_dump() if options is not None else {}
    chosen = ReadOptions(**(given | values))
    place = Path(path)
    if not place.exists():
        near = meant(place.name, _names_beside(place))
        raise FileNotFoundError(f"{place}: no such file or folder{near}")
    if chosen.metadata is not None:
        check_regular(chosen.metadata)
    if chosen.stamps != "own":
        from lidar_core.io.formats.restamped import RestampedRecording

        own = open_recording(place, chosen, stamps="own")
        return RestampedRecording(own, chosen)
    if check_regular_or_folder(place).is_dir():
        return _open_folder(place, chosen)
    if place.stat().st_size == 0:
        raise FormatError(f"{place}: the file is empty")
    return _open_file(place, chosen)


def _names_beside(path: Path) -> list[str]:
    """Names of what lies where a file was expected."""
    return [file.name for file in path.parent.iterdir()] if path.parent.is_dir() else []


def _open_file(path: Path, options: ReadOptions) -> Recording:
    suffix = path.suffix.lower()
    if suffix == ".bz2" and Path(path.stem).suffix.lower() == ".clf":
        suffix = ".clf"
    if path.name.lower().endswith(PACKED):
        return UnpackedRecording(path, options, [path], open_recording)
    openers: dict[str, Callable[[Path, ReadOptions], Recording]] = {
        ".bag": _open_bag,
        ".bin": _open_scan,
        ".las": _open_scan,
        ".laz": _open_scan,
        ".ply": _open_scan,
        ".clf": _open_log,
        ".db3": _open_database,
        ".mcap": _open_mcap,
        ".npz": _open_npz,
        ".osf": _open_osf,
        ".pcap": _open_pcap,
        ".pcapng": _open_pcap,
        ".pcd": _open_scan,
    }
    if suffix not in openers and (hint := hint_for(path)) is not None:
        raise FormatError(f"{path}: {hint}")
    if suffix not in openers:
        raise FormatError(f"{path}: unknown format {suffix!r}; readable are: {KNOWN}")
    return openers[suffix](path, options)


def _open_folder(path: Path, options: ReadOptions) -> Recording:
    files = sorted(file for file in path.iterdir() if file.is_file())
    kinds = {kind: found for kind in KINDS if (found := _of_kind(files, kind))}
    if len(kinds) > 1 and not (path / "metadata.yaml").exists():
        listed = ", ".join(f"{len(found)} of {_names(kind)}" for kind, found in kinds.items())
        raise FormatError(
            f"{path}: several kinds of recordings in this folder: {listed}; name one"
            " file, or a folder with one kind"
        )
    if not kinds:
        return _open_kitti(path, files, options)
    kind, found = next(iter(kinds.items()))
    if kind is ROS2:
        return _open_ros2(path, found, options)
    if kind is PACKED:
        return UnpackedRecording(path, options, found, open_recording)
    if kind in SEQUENCES:
        return _open_sequence(path, found, found[0].suffix.lower(), options)
    if len(found) == 1:
        return _open_file(found[0], options)
    if kind in CHAINS:
        from lidar_core.io.formats.chain import ChainedRecording

        return ChainedRecording(path, options, found, open_recording)
    listed = ", ".join(file.name for file in found)
    raise FormatError(f"{path}: several recordings in this folder; name one of {listed}")


def _of_kind(files: list[Path], kind: tuple[str, ...]) -> list[Path]:
    return [file for file in files if file.name.lower().endswith(kind)]


def _names(kind: tuple[str, ...]) -> str:
    return " or ".join(kind)


def _open_kitti(path: Path, files: list[Path], options: ReadOptions) -> Recording:
    """Scans in the folders where KITTI has them."""
    for inner in ("velodyne", "velodyne_points/data", "data"):
        scans = sorted((path / inner).glob("*.bin"))
        if scans:
            return _open_sequence(path, scans, ".bin", options)
    found = ", ".join(sorted({file.suffix or file.name for file in files})) or "no files"
    folders = sorted(one.name for one in path.iterdir() if one.is_dir())[:MOST_FOLDERS]
    if folders:
        raise FormatError(
            f"{path}: no recording in this folder, found {found}; name one of the"
            f" folders in it: {', '.join(folders)}"
        )
    raise FormatError(f"{path}: no recording in this folder, found {found}; readable are: {KNOWN}")


def _open_bag(path: Path, options: ReadOptions) -> Recording:
    """A bag of Ouster packets, where their library is installed; else any ROS 1 bag."""
    from lidar_core.io.formats.ouster import OusterRecording, holds_ouster_packets

    if holds_ouster_packets(path):
        return OusterRecording(path, options)
    from lidar_core.io.formats.ros import RosRecording

    return RosRecording(path, options, [path], version=1)


def _open_database(path: Path, options: ReadOptions) -> Recording:
    return _open_ros2(path, [path], options)


def _open_log(path: Path, options: ReadOptions) -> Recording:
    from lidar_core.io.formats.carmen import CarmenRecording

    return CarmenRecording(path, options)


def _open_mcap(path: Path, options: ReadOptions) -> Recording:
    from lidar_core.io.formats.mcap import McapRecording

    return McapRecording(path, options)


def _open_npz(path: Path, options: ReadOptions) -> Recording:
    from lidar_core.io.formats.npz import NpzRecording

    return NpzRecording(path, options)


def _open_osf(path: Path, options: ReadOptions) -> Recording:
    from lidar_core.io.formats.ouster import OsfRecording

    return OsfRecording(path, options)


def _open_scan(path: Path, options: ReadOptions) -> Recording:
    return _open_sequence(path, [path], path.suffix.lower(), options)


def _open_ros2(path: Path, files: list[Path], options: ReadOptions) -> Recording:
    from lidar_core.io.formats.ros import RosRecording

    return RosRecording(path, options, files, version=2)


def _open_sequence(path: Path, files: list[Path], suffix: str, options: ReadOptions) -> Recording:
    from lidar_core.io.formats import sequence

    readers: dict[str, type[sequence.SequenceRecording]] = {
        ".bin": sequence.KittiRecording,
        ".las": sequence.LasRecording,
        ".laz": sequence.LasRecording,
        ".pcd": sequence.PcdRecording,
        ".ply": sequence.PlyRecording,
    }
    return readers[suffix](path, options, files)


def _open_pcap(path: Path, options: ReadOptions) -> Recording:
    from lidar_core.io.files.pcap import VELODYNE_BYTES, packet_sizes
    from lidar_core.io.formats.ouster import OusterRecording, metadata_beside
    from lidar_core.io.formats.velodyne import VelodyneRecording

    sizes = packet_sizes(path)
    if options.metadata is not None or metadata_beside(path) is not None:
        if path.suffix.lower() == ".pcapng":
            raise FormatError(f"{path}: ouster-sdk reads pcap; convert it: editcap -F pcap IN OUT")
        return OusterRecording(path, options)
    if sizes[VELODYNE_BYTES]:
        return VelodyneRecording(path, options)
    seen = ", ".join(f"{count} of {size}" for size, count in sizes.most_common(3)) or "none"
    raise FormatError(
        f"{path}: packets (number of bytes: {seen}) are not Velodyne's; for Ouster, put its .json"
        " beside the file or name it with --metadata"
    )
