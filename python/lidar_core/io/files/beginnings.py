"""First bytes of formats, to recognise the format of a file whose name is wrong."""

from pathlib import Path

from lidar_core.errors import FormatError
from lidar_core.io.files import pcapng

MCAP, BAG, DATABASE = b"\x89MCAP0\r\n", b"#ROSBAG V", b"SQLite format 3\0"
ZIP, ZSTD = b"PK", b"\x28\xb5\x2f\xfd"
PCAP_ORDERS = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}
"""Beginnings of packet captures, and their byte order."""
_ENDINGS = {
    MCAP: ".mcap",
    BAG: ".bag",
    DATABASE: ".db3",
    pcapng.MAGIC: ".pcapng",
    **dict.fromkeys(PCAP_ORDERS, ".pcap"),
    b"# .PCD": ".pcd",
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"LASF": ".las",
    ZSTD: ".zst",
    b"\x1f\x8b\x08": ".gz",
    b"BZh": ".bz2",
    b"\xfd7zXZ\0": ".xz",
}
_LOOKED_AT = 128
"""Bytes that hold the longest beginning, and the name of the first array of an .npz file."""


def check_beginning(path: Path, expected: bytes, what: str) -> None:
    """Refuse a file that does not begin with the bytes of the format `what`.

    Raises
    ------
    FormatError
        It begins with other bytes.
    """
    with path.open("rb") as file:
        head = file.read(len(expected))
    if head != expected:
        raise not_a(path, what, head)


def not_a(path: Path, what: str, head: bytes) -> FormatError:
    """Return the error for a file that is not `what`, with its first bytes and likely format."""
    return FormatError(f"{path}: not {what}: it begins with {head!r}{likeness(path)}")


def likeness(path: Path) -> str:
    """Text that names the format that the content of a file looks like; empty if unknown."""
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
    ending = next((end for first, end in _ENDINGS.items() if head.startswith(first)), None)
    if head.startswith(ZIP):
        ending = ".npz" if b".npy" in head else ".zip"
    if ending is None or path.name.lower().endswith(ending):
        return ""
    return f"; its content looks like {ending}: give the file this ending"
