"""All scenes whose results are kept, by the file that keeps them."""

from collections.abc import Callable
from pathlib import Path

from golden import circles_replay, flying_replay, fusion_replay, runs_replay
from golden.digest import Record
from golden.recordings_replay import READ

FILES: dict[str, dict[str, Callable[[Record, int], None]]] = {
    "flying": flying_replay.SCENES,
    "circles": circles_replay.SCENES,
    "fusion": fusion_replay.SCENES,
    "runs": runs_replay.SCENES,
}
ON_TWO_THREADS = {
    "yard, best",
    "yard, paper",
    "uncertain poses, ends",
    "dropped rows, sky found",
    "rosette, sky found",
    "two LiDARs, masks",
    "tracker, best",
    "tracker, paper",
    "functions",
    "map, best",
    "map, one ray per end",
    "samples, anywhere",
    "detect, best",
}
"""Scenes that are played a second time, with two threads, to the same digests."""


def threads_of(file: str, scene: str) -> tuple[int, ...]:
    """Numbers of threads with which a scene is played; all give the same digests."""
    is_twice = scene in ON_TWO_THREADS or (file == "fusion" and scene.startswith("ukf"))
    return (1, 2) if is_twice else (1,)


def played(file: str, scene: str, threads: int) -> dict[str, dict]:
    """Digests of what a scene gives."""
    record = Record()
    FILES[file][scene](record, threads)
    return record.entries()


def read(name: str, data: Path) -> dict[str, dict]:
    """Digests of what is read from a recording."""
    record = Record()
    READ[name](record, data)
    return record.entries()
