"""Readers, writers and metrics: registered by a decorator, also by other packages.

The parts of this package are in folders whose files are imported when a part is first needed. The
parts of other packages are found by their entry points. A broken package does not affect the
others: a warning names it, and so does the error about an unknown name.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from threading import RLock
from typing import Generic, Protocol, TypeVar, get_args

from lidar_core.errors import ConfigError, LidarCoreError, PluginError, PluginWarning, unknown

__all__ = [
    "Part",
    "PartT",
    "Registry",
    "check_choice",
    "registering_module",
]


class Part(Protocol):
    """Part that can be registered."""

    @property
    def name(self) -> str:
        """Name of the part, unique in its registry."""

    @property
    def module(self) -> str:
        """Module that registers the part."""


PartT = TypeVar("PartT", bound=Part)


class Registry(Generic[PartT]):
    """Parts of one kind: those of this package in the order of their modules, then the others.

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
        self._inside = tuple(f"{folder}." for folder in folders)
        self._loaded: dict[EntryPoint, set[str]] = {}
        self._broken: dict[EntryPoint, PluginError] = {}
        self._path: tuple[str, ...] | None = None
        self._is_loading = False
        self._lock = RLock()

    def add(self, part: PartT) -> None:
        """Register a part; a module may replace its own, as cells of notebooks do.

        Raises
        ------
        ConfigError
            A part of another module has its name.
        """
        with self._lock:
            held = self._parts.get(part.name)
            if held is not None and held.module != part.module:
                raise ConfigError(
                    f"{self._what} {part.name!r}: already registered by {held.module}"
                )
            self._parts[part.name] = part

    def parts(self) -> list[PartT]:
        """Return all parts; packages that were installed since the last call are found, too."""
        with self._lock:
            # A plugin that asks for the parts while it is loaded gets those that there are.
            if self._path != tuple(sys.path) and not self._is_loading:
                self._is_loading = True
                try:
                    self._load_own()
                    self._load_plugins()
                    # Last: what an interrupt left out is looked for at the next call.
                    self._path = tuple(sys.path)
                finally:
                    self._is_loading = False
            own = [part for part in self._parts.values() if self._is_own(part)]
            others = [part for part in self._parts.values() if not self._is_own(part)]
            return sorted(own, key=lambda part: part.module) + others

    def registered(self) -> list[PartT]:
        """Parts registered so far, including those of this package; plugins are not searched."""
        with self._lock:
            if not self._is_loading:
                self._load_own()
            return list(self._parts.values())

    def get(self, name: str) -> PartT:
        """Return the part with this name.

        Raises
        ------
        PluginError
            The plugin of this name is broken.
        ConfigError
            There is no such part.
        """
        known = {part.name: part for part in self.parts()}
        if name in known:
            return known[name]
        for entry, error in self._broken.items():
            if entry.name == name:
                raise error
        raise ConfigError(unknown(self._what, name, known))

    def broken(self) -> list[PluginError]:
        """Return the errors of the plugins that cannot be loaded."""
        self.parts()
        return list(self._broken.values())

    def plugin_of(self, part: PartT) -> EntryPoint | None:
        """Return the entry point of a part; None for parts of this package and of scripts."""
        for entry, names in self._loaded.items():
            if part.name in names:
                return entry
        root = _root(part)
        same = (entry for entry in self._loaded if root == entry.module.partition(".")[0])
        return next(same, None)

    @contextmanager
    def calling(self, part: PartT) -> Iterator[None]:
        """Turn an exception in a part of another package into an error that names the package.

        Raises
        ------
        PluginError
            Anything but errors of this package and of the system.
        """
        try:
            yield
        except (LidarCoreError, OSError, MemoryError):
            raise
        except (Exception, SystemExit) as error:
            entry = self.plugin_of(part)
            if entry is not None:
                raise _plugin_error(entry, error) from error
            if self._is_own(part):
                raise
            place = f"{self._what} {part.name!r} of {part.module or 'a notebook'}"
            raise PluginError(f"{place}: {_cause_text(error)}") from error

    def _is_own(self, part: PartT) -> bool:
        # A part that is defined in a console or notebook may have no module.
        return (part.module or "").startswith(self._inside)

    def _load_own(self) -> None:
        for inside in self._inside:
            package = import_module(inside.removesuffix("."))
            for module in iter_modules(package.__path__, inside):
                import_module(module.name)

    def _load_plugins(self) -> None:
        for entry in sorted(entry_points(group=self._group)):
            if entry in self._broken or entry in self._loaded:
                continue
            before, root = dict(self._parts), entry.module.partition(".")[0]
            try:
                entry.load()
                # Also what a module of another package registers that it imports, and what was
                # registered when a script imported the package.
                brought = {
                    name
                    for name, part in self._parts.items()
                    if before.get(name) is not part or _root(part) == root
                }
                if not brought:
                    raise ConfigError(f"{entry.value} registers no {self._what}")
                for name in brought & before.keys():
                    if _root(before[name]) != root:
                        raise ConfigError(f"{self._what} {name!r}: already registered")
            except (Exception, SystemExit) as error:
                self._broken[entry] = _plugin_error(entry, error)
                self._parts = before
                warnings.warn(str(self._broken[entry]), PluginWarning, stacklevel=3)
            else:
                self._loaded[entry] = brought


def registering_module() -> str:
    """Return the name of the module that calls the decorator.

    The decorated reader, writer or metric may come from another module.
    """
    return sys._getframe(2).f_globals.get("__name__") or ""


def check_choice(what: str, name: str, choices: object) -> None:
    """Reject a value that is not in a `Literal`.

    Raises
    ------
    ConfigError
        Another value.
    """
    known = get_args(choices)
    if name not in known:
        raise ConfigError(unknown(what, name, known))


def _root(part: Part) -> str:
    """Name of the package that registers a part."""
    return (part.module or "").partition(".")[0]


def _cause_text(cause: BaseException) -> str:
    return str(cause) if isinstance(cause, LidarCoreError) else f"{type(cause).__name__}: {cause}"


def _plugin_error(entry: EntryPoint, cause: BaseException) -> PluginError:
    package = "unknown" if entry.dist is None else entry.dist.name
    error = PluginError(
        f"plugin {entry.name!r} of the package {package!r}: {_cause_text(cause)};"
        f" update or uninstall {package}"
    )
    error.__cause__ = cause
    return error


def __dir__() -> list[str]:
    return __all__
