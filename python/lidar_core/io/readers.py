"""Registry of readers of recordings, and choice of the reader of a file."""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

from lidar_core.errors import ConfigError, PluginError, PluginWarning
from lidar_core.io.options import ReadOptions
from lidar_core.io.recording import Recording
from lidar_core.plugins import Registry, check_choice, registering_module

__all__ = [
    "READERS",
    "Folder",
    "Open",
    "OpenT",
    "Reader",
    "Sniff",
    "known_formats",
    "owner_of",
    "reader_of",
    "register_reader",
    "suffix_of",
]

Open: TypeAlias = Callable[..., Recording]
Sniff: TypeAlias = Callable[[Path, ReadOptions], bool]
Folder: TypeAlias = Literal["single", "merged", "together"]
OpenT = TypeVar("OpenT", bound=Open)


@dataclass(frozen=True, slots=True)
class Reader:
    """One format of recordings.

    Attributes
    ----------
    name : str
        Name of the format in tables; unique.
    suffixes : tuple of str
        Ends of the names of its files, with the dot.
    open : callable
        `open(path, options)`, with `folder="together"` `open(path, options, files)`.
    sniff : callable or None
        `sniff(path, options)`: true if a file has this format. Readers with it are tried before the
        one without.
    extra : str or None
        Optional feature of the package that it needs.
    folder : str
        Meaning of several files in a folder: single recordings, of which one must be named;
        recordings to be merged by time; or together one recording.
    subfolders : tuple of str
        Subfolders with the files, for a folder that contains none itself.
    marker : str or None
        File that marks a folder of this format, whatever else it contains.
    note : str
        Additional note for tables of formats.
    module : str
        Module that registers it.
    """

    name: str
    suffixes: tuple[str, ...]
    open: Open
    sniff: Sniff | None = None
    extra: str | None = None
    folder: Folder = "single"
    subfolders: tuple[str, ...] = ()
    marker: str | None = None
    note: str = ""
    module: str = ""

    def opened(self, path: Path, options: ReadOptions, files: list[Path]) -> Recording:
        """Open a recording; `files` are the files in the folder `path`, or `path` itself.

        Raises
        ------
        PluginError
            The reader belongs to another package and is broken.
        """
        with READERS.calling(self):
            if self.folder == "together":
                return self.open(path, options, files)
            return self.open(path, options)

    def fits(self, path: Path, options: ReadOptions) -> bool:
        """Return whether a file has this format, by its content; False if the plugin is broken."""
        try:
            with READERS.calling(self):
                return self.sniff is None or self.sniff(path, options)
        except PluginError as error:
            warnings.warn(str(error), PluginWarning, stacklevel=2)
            return False


READERS: Registry[Reader] = Registry("reader", "lidar_core.readers", "lidar_core.io.formats")


def register_reader(
    name: str,
    suffixes: Iterable[str],
    sniff: Sniff | None = None,
    extra: str | None = None,
    *,
    folder: Folder = "single",
    subfolders: Iterable[str] = (),
    marker: str | None = None,
    note: str = "",
) -> Callable[[OpenT], OpenT]:
    """Register a reader: a subclass of `Recording`, or a function that returns one.

    The decorated function is called as `open(path, options)`. `open_recording`, `lidar-core info`,
    the error for unknown files and the tables of formats use the registry. Another package names
    the module of its reader as an entry point of the group `lidar_core.readers`.

    Parameters
    ----------
    name : str
        Name of the format in tables; unique.
    suffixes : iterable of str
        Ends of the names of its files, with the dot.
    sniff : callable, optional
        `sniff(path, options)` returns true if a file has this format, for endings that several
        formats share.
    extra : str, optional
        Extra of lidar_core that has to be installed.
    folder : str
        Meaning of several files in a folder: "single" recordings, recordings to be "merged" by
        time, or "together" one recording, which is opened with `open(path, options, files)`.
    subfolders : iterable of str
        Subfolders with the files, for a folder that contains none itself.
    marker : str, optional
        File that marks a folder of this format, whatever else it contains.
    note : str
        Additional note for tables of formats.

    Raises
    ------
    ConfigError
        Another reader has this name, or an ending has no dot.

    Examples
    --------
    >>> @register_reader("Toy", [".toy"])  # doctest: +SKIP
    ... class ToyRecording(Recording): ...
    """
    check_choice(f"reader {name!r}: folder", folder, Folder)
    ends = tuple(suffix.lower() for suffix in suffixes)
    for end in ends:
        if not end.startswith(".") or len(end) < 2:
            raise ConfigError(f"reader {name!r}: expected suffixes such as '.toy', got {end!r}")
    if not ends:
        raise ConfigError(f"reader {name!r}: expected at least one suffix")

    def register(opener: OpenT) -> OpenT:
        READERS.add(
            Reader(
                name,
                ends,
                opener,
                sniff,
                extra,
                folder,
                tuple(subfolders),
                marker,
                note,
                registering_module(),
            )
        )
        return opener

    return register


def suffix_of(path: Path) -> str | None:
    """Return the longest registered ending that the name of a file has; None without one."""
    name = path.name.lower()
    ends = {end for reader in READERS.parts() for end in reader.suffixes if name.endswith(end)}
    return max(ends, key=len, default=None)


def owner_of(suffix: str) -> Reader:
    """Return the reader of all files of an ending: the one without `sniff`."""
    takers = [reader for reader in READERS.parts() if suffix in reader.suffixes]
    return min(takers, key=lambda reader: reader.sniff is not None)


def reader_of(path: Path, options: ReadOptions) -> Reader | None:
    """Return the reader of a file; None for an unknown ending.

    Among readers of one ending, the first one that recognises the file is used, or else the one
    without `sniff`.
    """
    suffix = suffix_of(path)
    if suffix is None:
        return None
    takers = [reader for reader in READERS.parts() if suffix in reader.suffixes]
    sniffed = (one for one in takers if one.sniff is not None and one.fits(path, options))
    return next(sniffed, owner_of(suffix))


def known_formats() -> str:
    """Return all formats as text, and the packages that are broken."""
    listed = ", ".join(f"{one.name} ({' or '.join(one.suffixes)})" for one in READERS.parts())
    return "; ".join([listed, *map(str, READERS.broken())])


def __dir__() -> list[str]:
    return __all__
