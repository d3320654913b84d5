"""Selection of the topic of a recording that has the wanted scans."""

from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple

from lidar_core.errors import ConfigError, FormatError, did_you_mean
from lidar_core.io.records import Topic
from lidar_core.messages import LaserScan, Scan

if TYPE_CHECKING:
    from lidar_core.io.recording import Recording

NAMELESS = "(no topic)"


class _Words(NamedTuple):
    """Words and options for one kind of scans in messages to the user."""

    kinds: frozenset[str]
    plural: str
    option: str
    command: str
    capability: str


WORDS: dict[type, _Words] = {
    Scan: _Words(frozenset({"scan", "scan+pose"}), "clouds", "cloud", "detect", "flying"),
    LaserScan: _Words(
        frozenset({"planar", "planar+pose"}), "2D scans", "scan", "circles", "circles"
    ),
}


def scan_topics(
    recording: "Recording",
    sorts: Collection[type],
    names: Collection[str] = (),
    *,
    is_live: bool = False,
) -> list[Topic]:
    """Return the topics with scans: the named ones, or all if `names` is empty.

    Parameters
    ----------
    recording : Recording
        Recording to search.
    sorts : collection of type
        `Scan`, `LaserScan`, or both.
    names : collection of str
        Names of topics; each must exist.
    is_live : bool
        The scans are for a live run: for scans of the other kind, errors name its argument
        `capability`, not a command.

    Raises
    ------
    ConfigError
        There is no topic of this name with scans of this kind.
    FormatError
        There are no scans of this kind.
    """
    words = [WORDS[sort] for sort in sorts]
    plural = " or ".join(word.plural for word in words)
    topics = recording.topics()
    with_scans = [topic for topic in topics if any(topic.kind in word.kinds for word in words)]
    known = [topic.name for topic in with_scans]
    for name in names:
        if name not in known:
            option = " or ".join(word.option for word in words)
            raise ConfigError(
                f"{option}: no topic {name!r} with {plural} in {recording.path};"
                f" found {listed(known)}{did_you_mean(name, known)}"
            )
    if not with_scans:
        found = listed(
            [f"{t.name or NAMELESS} ({t.type}{', ' + t.note if t.note else ''})" for t in topics]
        )
        other = "".join(
            f"; {word.plural} are for "
            + (f'capability="{word.capability}"' if is_live else f"`lidar-core {word.command}`")
            for sort, word in WORDS.items()
            if sort not in sorts and any(topic.kind in word.kinds for topic in topics)
        )
        raise FormatError(f"{recording.path}: no {plural} to read; found {found}{other}")
    return [topic for topic in with_scans if not names or topic.name in names]


def scan_topic(recording: "Recording", name: str | None, sort: type) -> Topic:
    """Return the only topic with scans of a kind, or the named one; otherwise as `scan_topics`."""
    chosen = scan_topics(recording, [sort], [] if name is None else [name])
    if name is None and len(chosen) > 1:
        words, found = WORDS[sort], listed([topic.name for topic in chosen])
        raise ConfigError(
            f"{words.option}: several topics with {words.plural} in {recording.path}:"
            f" {found}; name one with {words.option}=TOPIC"
        )
    return chosen[0]


def listed(names: list[str]) -> str:
    """Return the names as text."""
    return ", ".join(name or NAMELESS for name in sorted(names)) or "none"
