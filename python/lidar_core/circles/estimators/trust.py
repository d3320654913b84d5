"""ONNX models that may run: those of the package, and those that the user trusts.

A model is a program. A card beside it proves that the file is whole, not where it comes from:
whoever sends a model can write its card. So trust is kept where only the user writes: in a list of
SHA-256 sums in the user's own folder of settings, which `lidar-core export` adds to.
"""

import json
import os
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path

from lidar_core.circles.estimators.detector_name import MODELS
from lidar_core.errors import ConfigError, LimitError
from lidar_core.io.files.atomic import written_whole

MOST_BYTES = 256 * 2**20
"""Size of a model, and of the list."""


def trust_model(path: str | Path) -> Path | None:
    """Add an ONNX file to the models that this user runs without being asked again.

    Parameters
    ----------
    path : str or Path
        The file; from now on its content is trusted, not its path.

    Returns
    -------
    Path or None
        The list that contains it; None if the user has no folder for settings or it cannot be
        written: the model then needs `allow_untrusted`.

    Raises
    ------
    ConfigError
        There is no such file.
    LimitError
        It is larger than 256 MiB.
    """
    digest, place = sha256(content_of(Path(path))).hexdigest(), trusted_list()
    if place is None:
        return None
    try:
        known = _listed(place)
        if digest not in known:
            place.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(place) as temporary:
                lines = [*known, digest]
                temporary.write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
    except OSError:
        return None
    return place


def check_trusted(path: Path, content: bytes, *, allow_untrusted: bool) -> None:
    """Refuse a model that is neither the package's nor trusted by the user.

    Raises
    ------
    ConfigError
        The model is not trusted; the text names the options.
    """
    if allow_untrusted:
        return
    digest, place = sha256(content).hexdigest(), trusted_list()
    if digest in _shipped() or (place is not None and digest in _listed(place)):
        return
    raise ConfigError(
        f"{path}: lidar_core did not export this model on this machine (SHA-256"
        f" {digest[:12]}...). A model is a program; if you trust its source, use"
        " allow_untrusted=True"
    )


def content_of(path: Path) -> bytes:
    """Read the bytes of a model.

    Raises
    ------
    ConfigError
        There is no such file.
    LimitError
        It is too large.
    """
    if not path.is_file():
        raise ConfigError(f"detector: there is no file {str(path)!r}")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise LimitError(f"{path}: a model of {size} bytes, limit {MOST_BYTES}")
    return path.read_bytes()


def trusted_list() -> Path | None:
    """The user's list of trusted models; None for a user without a folder."""
    given = os.environ.get("APPDATA" if sys.platform == "win32" else "XDG_CONFIG_HOME", "")
    try:
        folder = Path(given) if Path(given).is_absolute() else Path.home() / ".config"
    except RuntimeError:  # no home
        return None
    return folder / "lidar_core" / "trusted-models.txt"


def _listed(place: Path) -> list[str]:
    if not place.is_file() or place.stat().st_size > MOST_BYTES:
        return []
    return place.read_text(encoding="ascii", errors="replace").split()


@cache
def _shipped() -> frozenset[str]:
    """SHA-256 sums of the package's own models, from their cards."""
    cards = (json.loads(card.read_text(encoding="utf-8")) for card in MODELS.glob("*.json"))
    return frozenset(str(card["sha256"]) for card in cards)
