"""Note in the folder of a batch about its origin: batch file, command, versions."""

from pathlib import Path

from lidar_core.batch import BatchConfig, JobRecord
from lidar_core.batch.results import NOTE
from lidar_core.config import toml_values
from lidar_core.files import read_whole
from lidar_core.io.files.atomic import written_whole
from lidar_core.run_folder import note_of

ORIGIN = "batch.toml"


def check_origin(folder: Path, file: Path, jobs: set[str]) -> None:
    """Refuse a folder whose tables belong to another batch file, and would be replaced.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    file : Path
        Batch file.
    jobs : set of str
        Names of its jobs.

    Raises
    ------
    FileExistsError
        The folder holds a finished job of another batch file, and that job is none of `jobs`.
    """
    earlier = _origin(folder)
    if earlier not in (None, _told_path(file)) and _has_other_jobs(folder, jobs):
        raise FileExistsError(
            f"{folder}: holds finished jobs of another batch file, {earlier}, and this batch would"
            " replace their tables; choose another folder, or, if it is the same batch file under"
            f" another name, remove {folder / ORIGIN}"
        )


def write_origin(folder: Path, file: Path, config: BatchConfig) -> None:
    """Write the note."""
    text = note_of({"jobs": _told_path(file)}, {"batch": config})
    with written_whole(folder / ORIGIN) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _told_path(file: Path) -> str:
    """Return the whole path of a batch file, as a note can hold it."""
    return str(file.resolve()).encode("utf-8", "replace").decode("utf-8")


def _origin(folder: Path) -> str | None:
    """Return the path of the batch file whose jobs are in the folder; None if it is not known."""
    try:
        note = toml_values(read_whole(folder / ORIGIN), ORIGIN)
        place = Path(note["input"]["jobs"])
        return _told_path(place) if place.is_absolute() else None
    except (OSError, ValueError, KeyError, TypeError):  # no such note, or none of a batch
        return None


def _has_other_jobs(folder: Path, names: set[str]) -> bool:
    """Return whether the folder holds a finished job that is none of these."""
    others = (one.parent for one in folder.glob(f"*/{NOTE}") if one.parent.name not in names)
    records = map(JobRecord.read, others)
    return any(record is not None and record.status == "done" for record in records)
