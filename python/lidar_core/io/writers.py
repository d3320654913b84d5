"""Registry of writers, and choice of the writer of a file."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

from lidar_core.errors import ConfigError
from lidar_core.plugins import Registry, check_choice, registering_module

__all__ = [
    "SOURCES",
    "WRITERS",
    "Takes",
    "Write",
    "WriteT",
    "Writer",
    "ending_of",
    "register_writer",
    "writer_of",
    "writers_of",
]

Takes: TypeAlias = Literal["messages", "objects", "points"]
Write: TypeAlias = Callable[..., Any]
WriteT = TypeVar("WriteT", bound=Write)
SOURCES: dict[Takes, str] = {
    "messages": "a recording",
    "objects": "a run",
    "points": "a cloud or map",
}


@dataclass(frozen=True, slots=True)
class Writer:
    """One output format.

    Attributes
    ----------
    format : str
        Name of the format in tables.
    suffixes : tuple of str
        Ends of the names of its files, with the dot; empty for a new folder.
    takes : str
        Input of the writer: messages of a recording, objects of a run, points of a cloud or map.
    write : callable
        `write(path, messages)`, `write(path, objects)` with `RunObjects`, or
        `write(path, points, resolution)`.
    extra : str or None
        Optional feature of the package that it needs.
    needs_resolution : bool
        True if it writes voxels made of points.
    module : str
        Module that registers it.
    """

    format: str
    suffixes: tuple[str, ...]
    takes: Takes
    write: Write
    extra: str | None = None
    needs_resolution: bool = False
    module: str = ""

    @property
    def name(self) -> str:
        """Unique name: formats can hold more than one kind of data."""
        return f"{self.format} of {self.takes}"

    def __call__(self, *values: Any) -> Any:
        """Call `write` with these values and return its result.

        Raises
        ------
        PluginError
            The writer is of another package, and broken.
        """
        with WRITERS.calling(self):
            return self.write(*values)

    def __str__(self) -> str:
        """Return the format and the endings of its files as text."""
        ends = " or ".join(end or "a new folder" for end in self.suffixes)
        return f"{ends} ({self.format})"


WRITERS: Registry[Writer] = Registry(
    "writer", "lidar_core.writers", "lidar_core.io.write", "lidar_core.io.maps"
)


def register_writer(
    name: str,
    suffixes: Iterable[str],
    extra: str | None = None,
    *,
    takes: Takes,
    needs_resolution: bool = False,
) -> Callable[[WriteT], WriteT]:
    """Register a function that writes one output format atomically.

    `lidar-core convert` and the errors for unknown endings use the registry. Another package names
    the module of its writer as an entry point of the group `lidar_core.writers`.

    Parameters
    ----------
    name : str
        Name of the format in tables; unique among writers with the same input.
    suffixes : iterable of str
        Ends of the names of its files, with the dot; empty for a new folder.
    extra : str, optional
        Extra of lidar_core that has to be installed.
    takes : str
        "messages": the function is called as `write(path, messages)` with `Scan`, `LaserScan` and
        `Pose` in the order of time. "objects": `write(path, objects)` with the `RunObjects` of a
        run; it may return names of topics. "points": `write(path, points, resolution)` with an
        array (N, 3) [m], and the edge of the voxels that they are the centres of [m], or None.
    needs_resolution : bool
        True if it writes voxels made of points: `resolution` is then a number.

    Raises
    ------
    ConfigError
        Another writer has this name, or the same ending for the same input.

    Examples
    --------
    >>> @register_writer("Toy", [".toy"], takes="objects")  # doctest: +SKIP
    ... def write_toy(path, objects): ...
    """
    check_choice(f"writer {name!r}: takes", takes, Takes)
    ends = tuple(suffix.lower() for suffix in suffixes)
    for end in ends:
        if end and (not end.startswith(".") or len(end) < 2):
            raise ConfigError(f"writer {name!r}: expected suffixes such as '.toy', got {end!r}")
    if not ends:
        raise ConfigError(f"writer {name!r}: expected at least one suffix")

    def register(write: WriteT) -> WriteT:
        module = registering_module()
        made = Writer(name, ends, takes, write, extra, needs_resolution, module)
        # The modules of this package are loaded one by one, and take different endings.
        is_own = module.startswith(("lidar_core.io.write.", "lidar_core.io.maps."))
        for other in () if is_own else WRITERS.registered():
            if other.takes == takes and other.name != made.name:
                for end in set(ends) & set(other.suffixes):
                    raise ConfigError(
                        f"writer {name!r}: suffix {end!r} is already registered by {other.module}"
                    )
        WRITERS.add(made)
        return write

    return register


def writers_of(takes: Takes) -> dict[str, Writer]:
    """Return the writers for one kind of input by the endings of their files."""
    known: dict[str, Writer] = {}
    for writer in WRITERS.parts():
        if writer.takes == takes:
            known |= {end: writer for end in writer.suffixes if end not in known}
    return known


def ending_of(path: Path, known: Iterable[str]) -> str:
    """Return the longest `known` ending of a name, or else the part after its last dot."""
    name = path.name.lower()
    ends = [end for end in known if end and name.endswith(end) and name != end]
    return max(ends, key=len, default=path.suffix.lower())


def writer_of(path: Path, takes: Takes) -> Writer:
    """The writer of the format that the ending of a name chooses.

    Raises
    ------
    ConfigError
        Another ending.
    """
    known = writers_of(takes)
    suffix = ending_of(path, known)
    if suffix not in known:
        listed = ", ".join(dict.fromkeys(map(str, known.values())))
        broken = "".join(f"; {error}" for error in WRITERS.broken())
        raise ConfigError(
            f"{path}: unknown suffix {suffix!r}; formats for {SOURCES[takes]}: {listed}{broken}"
        )
    return known[suffix]


def __dir__() -> list[str]:
    return __all__
