"""Import of optional dependencies in one place, with an error that states the install command."""

import json
from importlib import import_module
from importlib.metadata import Distribution, PackageNotFoundError
from pathlib import Path
from shlex import quote
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from lidar_core.errors import MissingExtraError

__all__ = ["NAME", "install_command", "require"]

NAME = "lidar-core"
TRAIN, TRAINING = "train", "training"
"""The extra of the distribution lidar-core-training, and the folder of that in a checkout."""


def require(module: str, *, extra: str, purpose: str) -> Any:
    """Import `module`, which the extra `extra` installs.

    Raises
    ------
    MissingExtraError
        The module is not installed; the text gives the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs the package {module.partition('.')[0]!r}: {install_command(extra)}"
        ) from error


def install_command(extra: str) -> str:
    """Return the command that installs an extra from the source of this package.

    The source is the package index, a wheel file, a checkout or a repository; pip notes it in
    direct_url.json (PEP 610). Without that note it is the index. The extra "train" comes with the
    distribution lidar-core-training, which lies in the checkout.
    """
    note = _note()
    if extra == TRAIN:
        return _training_command(note)
    if note is None:  # a checkout that is only on the path
        return f"pip install {_quoted(_checkout() or NAME, extra)}"
    url = str(note.get("url", ""))
    if "vcs_info" in note:
        told = note["vcs_info"]
        place_in_vcs = "{vcs}+{url}@{commit_id}".format(**told, url=url)
        return f"pip install {_at(place_in_vcs, extra)}"
    if not url.startswith("file:"):
        return f"pip install {_at(url, extra) if url else _quoted(NAME, extra)}"
    place = _path(url)
    if "dir_info" in note:
        option = "-e " if note["dir_info"].get("editable") else ""
        gone = "" if place.is_dir() else f" (it was installed from {place}, which is gone)"
        return f"pip install {option}{_quoted(place, extra)}{gone}"
    gone = "" if place.is_file() else f" (it was installed from {place}, which is gone)"
    return f"pip install {_quoted(place if not gone else place.name, extra)}{gone}"


def _training_command(note: dict[str, Any] | None) -> str:
    """Command that installs the training distribution, which installs the packages of its extra."""
    if note is None:
        checkout = _checkout()
    else:
        checkout = _path(str(note["url"])) if "dir_info" in note else None
    if checkout is None or not (checkout / TRAINING / "pyproject.toml").is_file():
        return f"pip install . ./{TRAINING} (in a checkout of lidar_core)"
    own = f"{quote(str(checkout))} " if note is None else ""  # else it is installed already
    return f"pip install {own}{quote(str(checkout / TRAINING))}"


def _note() -> dict[str, Any] | None:
    """Pip's note of the source of this package; empty without one, None if not installed."""
    try:
        note = json.loads(_distribution().read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}


def _path(url: str) -> Path:
    return Path(url2pathname(urlsplit(url).path))


def _distribution() -> Distribution:
    return Distribution.from_name(NAME)


def _checkout() -> Path | None:
    """Folder of the checkout that contains this file; None without one."""
    top = Path(__file__).parents[2]
    return top if (top / "pyproject.toml").is_file() else None


def _quoted(what: object, extra: str) -> str:
    return quote(f"{what}[{extra}]")


def _at(url: str, extra: str) -> str:
    return quote(f"{NAME}[{extra}] @ {url}")


def __dir__() -> list[str]:
    return __all__
