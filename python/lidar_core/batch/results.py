"""Results of the jobs of a batch: a file job.json in every folder, and one table of all jobs."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

from lidar_core.files import check_regular
from lidar_core.io.files.atomic import written_whole
from lidar_core.io.tables.long_table import write_long_table
from lidar_core.util.reasons import kind_of

NOTE = "job.json"
Status: TypeAlias = Literal["running", "done", "failed"]
FIRST = ("job", "group", "key", "status", "seconds", "error")
"""Columns that every table of results has."""
BY_REASON = frozenset({"without_pose", "rejected", "invalid"})
"""Results of commands that are counts by reason."""


@dataclass(frozen=True, slots=True)
class JobRecord:
    """Content of job.json.

    Attributes
    ----------
    job : str
        Name of the folder.
    group : str
        Name of the group.
    key : str
        Digest of everything that determines the result: commands, files, versions.
    status : str
        "running", "done" or "failed". A job is "running" without a process if it was interrupted.
    seconds : float
        Duration of the job [s].
    error : str
        Error message of a failed job.
    values : dict
        Value of every {NAME}.
    numbers : dict
        Numbers of the JSON results of the commands, by dotted path.
    events : list of dict
        Events of the objects of the job's runs, one row each.
    """

    job: str
    group: str
    key: str
    status: Status
    seconds: float = 0.0
    error: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read the record of a folder; None if there is no readable one."""
        try:
            return cls.parsed(check_regular(folder / NOTE).read_bytes())
        except (OSError, ValueError):
            return None

    @classmethod
    def parsed(cls, data: bytes) -> Self | None:
        """Read the record in a job.json; None if it is not one."""
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError, RecursionError):
            return None

    def write(self, folder: Path, *, is_first: bool = False) -> None:
        """Write job.json atomically; `is_first`: there is no earlier one to replace.

        The first job.json need not reach the disk before the job continues: a job without one
        starts again.
        """
        text = json.dumps(asdict(self), indent=2) + "\n"
        with written_whole(folder / NOTE, synced=not is_first) as temporary:
            temporary.write_text(text, encoding="utf-8")


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Flatten nested results: values by dotted path, rows of a list by name.

    Counts by reason also have their sum. Reasons that differ only in their numbers, such as stamps,
    are one, with # for each number: runs of many recordings then share columns.
    """
    if isinstance(value, Mapping):
        if path.rpartition(".")[2] in BY_REASON and _are_counts(value.values()):
            kinds: Counter[str] = Counter()
            for reason, count in value.items():
                kinds[f"{path}.{kind_of(str(reason))}"] += count
            return {path: kinds.total(), **kinds}
        items = [(str(name), inner) for name, inner in value.items()]
    elif isinstance(value, list) and all(isinstance(item, Mapping) for item in value):
        rows = [dict(item) for item in value if "name" in item]
        items = [(str(row.pop("name")), row) for row in rows]
    elif value is None or isinstance(value, str | int | float | bool):
        return {path: value}
    else:
        return {}
    found: dict[str, Any] = {}
    for name, inner in items:
        found |= flat(inner, f"{path}.{name}" if path else name)
    return found


def _are_counts(values: Iterable[Any]) -> bool:
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)


def write_results(path: Path, records: Sequence[JobRecord]) -> Path:
    """Write one row per job: its parameters, its outcome, its values and its numbers.

    Parameters
    ----------
    path : Path
        Parquet, if it ends in .parquet and pyarrow is installed; otherwise CSV, ending in .csv.
    records : sequence of JobRecord
        In the order of the rows.

    Returns
    -------
    path : Path
        File that was written.
    """
    rows = [
        {name: getattr(record, name) for name in FIRST}
        | {f"value.{name}": value for name, value in record.values.items()}
        | record.numbers
        for record in records
    ]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _kind([row.get(name) for row in rows]) for name in names}
    return write_long_table(
        path, columns, [[_as(row.get(name), columns[name]) for name in names] for row in rows]
    )


def _kind(values: Sequence[Any]) -> type:
    """Return the type that can hold all values of a column."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} and kinds:
        return bool
    if kinds <= {int} and kinds:
        return int
    return float if kinds <= {int, float} else str


def _as(value: Any, kind: type) -> Any:
    return None if value is None else kind(value)
