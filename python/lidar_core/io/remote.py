"""Files of other machines (s3, gs, http, ...), through fsspec: listed, fetched and stored whole."""

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from lidar_core.errors import FormatError, MissingExtraError
from lidar_core.extras import install_command, require

_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]*)://")
EXTRA, PURPOSE = "cloud", "files of other machines"


def is_remote(text: str) -> bool:
    """True if a text is an address such as s3://bucket/a.mcap; file:// also counts."""
    return _ADDRESS.match(text) is not None


def joined(address: str, name: str) -> str:
    """Address of a file in a folder."""
    return f"{address.rstrip('/')}/{name}"


def matching(pattern: str) -> list[str]:
    """Addresses that match a pattern with * and **, in order.

    Raises
    ------
    MissingExtraError
        fsspec, or the package for this kind of address, is not installed.
    """
    files, path = _opened(pattern)
    found: list[str] = files.glob(path)
    return sorted(str(files.unstrip_protocol(one)) for one in found)


def file_versions(address: str) -> list[tuple[str, int, str]]:
    """Name, size and version (or time) of a file, or of all files of a folder."""
    files, path = _opened(address)
    if files.isfile(path):
        return [_file_version(address, files.info(path))]
    found = files.find(path, detail=True)
    return [_file_version(name, info) for name, info in sorted(found.items())]


def fetched(address: str, folder: Path) -> Path:
    """Copy a file, or a folder with all its files, into `folder`; return where it is.

    Raises
    ------
    FileNotFoundError
        The address does not exist.
    """
    files, path = _opened(address)
    place = folder / _name(path)
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):  # asking first whether it is a file takes a request more
        files.get_file(path, str(place))
        if place.is_file():
            return place
    names = files.find(path)
    if not names:
        raise FileNotFoundError(f"{address}: no such file or folder")
    root = str(files._strip_protocol(path)).rstrip("/")
    for name in names:
        inner = PurePosixPath(str(name).removeprefix(root).lstrip("/"))
        if inner.is_absolute() or ".." in inner.parts:
            raise FormatError(f"{address}: a file named {name!r} would leave its folder")
        target = place / inner
        target.parent.mkdir(parents=True, exist_ok=True)
        files.get_file(name, str(target))
    return place


def texts(pattern: str) -> dict[str, bytes]:
    """Read the files that match a pattern, all at a time; return their content by address."""
    files, path = _opened(pattern)
    files.invalidate_cache()
    names = files.glob(path)
    held: dict[str, bytes] = files.cat(names) if names else {}
    return {str(files.unstrip_protocol(name)): data for name, data in held.items()}


def held_names(address: str) -> set[str]:
    """Names of the files and folders in a folder; empty if it does not exist."""
    files, path = _opened(address)
    files.invalidate_cache()
    try:
        found = files.ls(path, detail=False)
    except FileNotFoundError:
        return set()
    return {PurePosixPath(str(one).rstrip("/")).name for one in found}


def stored(
    folder: Path, address: str, *, last: Sequence[str] = (), is_replaced: bool = True
) -> None:
    """Copy a folder to an address, without its old files; the files `last` are copied last.

    With `is_replaced` false the folder must be new, which saves the requests that look for old
    files.
    """
    files, path = _opened(address)
    files.invalidate_cache()
    if is_replaced and files.exists(path):
        files.rm(path, recursive=True)
    found = sorted(one for one in folder.rglob("*") if one.is_file())
    at_end = [one for one in found if one.name in last and one.parent == folder]
    first = [one for one in found if one not in at_end]
    for group in filter(None, (first, at_end)):
        inner = [one.relative_to(folder).as_posix() for one in group]
        _put(files, group, [joined(path, name) for name in inner])


def stored_file(file: Path, address: str) -> None:
    """Copy a file to an address."""
    files, path = _opened(address)
    _put(files, [file], [path])


def _put(files: Any, sources: Sequence[Path], places: Sequence[str]) -> None:
    """Copy files, together if the file system can; missing folders are made only after an error.

    Object stores have no folders, and a request for one takes as long as writing a small file.
    """
    names = [str(source) for source in sources]
    try:
        files.put(names, list(places))
    except FileNotFoundError:
        for parent in sorted({place.rpartition("/")[0] for place in places}):
            files.makedirs(parent, exist_ok=True)
        files.put(names, list(places))


def removed(address: str) -> None:
    """Remove a file, if it is there."""
    files, path = _opened(address)
    if files.exists(path):
        files.rm(path, recursive=True)


def _opened(address: str) -> tuple[Any, str]:
    core = require("fsspec.core", extra=EXTRA, purpose=PURPOSE)
    try:
        files, path = core.url_to_fs(address)
    except ImportError as error:
        kind = address.partition("://")[0]
        raise MissingExtraError(
            f"{kind}:// needs a package of its own ({error}): {install_command(EXTRA)}"
        ) from error
    except ValueError as error:
        raise FormatError(f"{address}: {error}") from error
    return files, str(path)


def _name(path: str) -> str:
    name = PurePosixPath(path.rstrip("/").partition("?")[0]).name
    if name in {"", ".."}:
        raise FormatError(f"{path}: expected an address that ends in the name of a file")
    return name


def _file_version(name: str, info: dict[str, Any]) -> tuple[str, int, str]:
    version = next((info[key] for key in ("ETag", "etag", "mtime", "created") if key in info), "")
    return name, int(info.get("size") or 0), str(version)
