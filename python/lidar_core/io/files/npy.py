"""Arrays of .npz archives; their sizes are checked before memory is allocated."""

import math
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.io.files.guard import check_size


def archive_of(path: Path) -> ZipFile:
    """Open an .npz file; the caller closes it.

    Raises
    ------
    FormatError
        Its list of arrays, which is at its end, is missing.
    """
    try:
        return ZipFile(path)
    except BadZipFile as error:
        raise FormatError(
            f"{path}: cannot be read: the file ends at byte {path.stat().st_size} without the list"
            " of its arrays; it seems to be cut off, or is no .npz file: copy or write it again"
        ) from error


def array_in(archive: ZipFile, name: str, *, what: str, limit: int, key: str) -> NDArray[Any]:
    """Return the array `name` of an archive, of at most `limit` bytes; errors call it `what`.

    Raises
    ------
    FormatError
        The header states another size than the data have; nothing is allocated.
    LimitError
        The array is larger; the text names the option `key`.
    """
    place = f"{archive.filename}, {what} {name}"
    info = archive.getinfo(f"{name}.npy")
    check_size(place, info.file_size, limit=limit, key=key, what="bytes")
    with archive.open(info) as stream:
        data = stream.read(limit + 1)
    check_size(place, len(data), limit=limit, key=key, what="bytes")
    content = BytesIO(data)
    version = np.lib.format.read_magic(content)
    read_header = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(content)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(data) - content.tell():
        raise FormatError(f"{place}: header states {dtype} {shape}, data has another size")
    content.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(content, allow_pickle=False)
    return array
