"""Readers, writers and metrics: registered by a decorator, also by other packages.

The parts of this package lie in folders whose files are imported when a part is first looked for.
Those of other packages are found by their entry points. A broken package does not affect the
others: a warning names it, and so does the error if something is asked for that nobody knows.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from threading import RLock
from typing import Generic, Protocol, TypeVar

from lidar_core.errors import ConfigError, LidarCoreError, PluginError, PluginWarning, unknown


class Part(Protocol):
    """What can be registered."""

    @property
    def name(self) -> str:
        """By which it is found; unique in its registry."""

    @property
    def module(self) -> str:
        """Module that registers it."""


PartT = TypeVar("PartT", bound=Part)


class Registry(Generic[PartT]):
    """Parts of one sort: those of this package in the order of their modules, then the others.

    Parameters
    ----------
    what : str
        A word for its parts, for errors.
    group : str
        Group of entry points by which other packages add parts.
    folders : str
        Packages whose modules register the parts of this package.
    """

    def __init__(self, what: str, group: str, *folders: str) -> None:
        self._what, self._group, self._folders = what, group, folders
        self._parts: dict[str, PartT] = {}
        self._loaded: list[EntryPoint] = []
        self._broken: dict[EntryPoint, PluginError] = {}
        self._path: tuple[str, ...] | None = None
        self._lock = RLock()

    def add(self, part: PartT) -> None:
        """Register a part; a module may replace its own, as cells of notebooks do.

        Raises
        ------
        ConfigError
            One of another module has its name.
        """
        with self._lock:
            held = self._parts.get(part.name)
            if held is not None and held.module != part.module:
                raise ConfigError(
                    f"{self._what} {part.name!r}: already registered by {held.module}"
                )
            self._parts[part.name] = part

    def parts(self) -> list[PartT]:
        """All parts; packages that were installed since the last call are found, too."""
        with self._lock:
            if self._path is None:
                for folder in self._folders:
                    for module in iter_modules(import_module(folder).__path__, f"{folder}."):
                        import_module(module.name)
            if self._path != tuple(sys.path):
                self._path = tuple(sys.path)
                self._load_plugins()
            inside = tuple(f"{folder}." for folder in self._folders)
            # A part that is defined in a console or notebook has no module.
            modules = {name: part.module or "" for name, part in self._parts.items()}
            own = [self._parts[name] for name in modules if modules[name].startswith(inside)]
            others = [self._parts[name] for name in modules if not modules[name].startswith(inside)]
            return sorted(own, key=lambda part: part.module) + others

    def get(self, name: str) -> PartT:
        """The part of a name.

        Raises
        ------
        PluginError
            The plugin of this name is broken.
        ConfigError
            There is none.
        """
        known = {part.name: part for part in self.parts()}
        if name in known:
            return known[name]
        for entry, error in self._broken.items():
            if entry.name == name:
                raise error
        raise ConfigError(unknown(self._what, name, known))

    def broken(self) -> list[PluginError]:
        """Errors of the plugins that cannot be loaded."""
        self.parts()
        return list(self._broken.values())

    def plugin_of(self, part: PartT) -> EntryPoint | None:
        """The entry point that brought a part; None for those of this package."""
        root = _root(part.module)
        return next((entry for entry in self._loaded if _root(entry.module) == root), None)

    @contextmanager
    def calling(self, part: PartT) -> Iterator[None]:
        """Turn a mistake in a part of another package into an error that names the package.

        Raises
        ------
        PluginError
            Anything but errors of this package and of the system.
        """
        try:
            yield
        except (LidarCoreError, OSError, MemoryError):
            raise
        except Exception as error:
            entry = self.plugin_of(part)
            if entry is None:
                raise
            raise _plugin_error(entry, error) from error

    def _load_plugins(self) -> None:
        for entry in sorted(entry_points(group=self._group)):
            if entry in self._broken or entry in self._loaded:
                continue
            before, root = dict(self._parts), _root(entry.module)
            try:
                entry.load()
                if all(_root(part.module) != root for part in self._parts.values()):
                    raise ConfigError(f"{entry.value} registers no {self._what}")
            except Exception as error:
                self._broken[entry] = _plugin_error(entry, error)
                self._parts = before
                warnings.warn(str(self._broken[entry]), PluginWarning, stacklevel=3)
            else:
                self._loaded.append(entry)


def _root(module: str) -> str:
    """Name of the package that a module lies in."""
    return module.partition(".")[0]


def _plugin_error(entry: EntryPoint, cause: Exception) -> PluginError:
    package = "unknown" if entry.dist is None else entry.dist.name
    told = str(cause) if isinstance(cause, LidarCoreError) else f"{type(cause).__name__}: {cause}"
    error = PluginError(
        f"plugin {entry.name!r} of the package {package!r}: {told}; update or uninstall {package}"
    )
    error.__cause__ = cause
    return error
