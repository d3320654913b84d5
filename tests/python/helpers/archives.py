"""Archives of the recordings, unpacked by means that every Python 3.11 has."""

import shutil
import tarfile
from pathlib import Path


def unpack(path: Path, folder: Path, *, suffix: str = "", most: int | None = None) -> list[str]:
    """Unpack the first `most` plain files, of those that end in `suffix`; their names.

    The files must be in the order of their names: what comes after the last one is not read.
    """
    names: list[str] = []
    with tarfile.open(path, "r|*") as archive:
        for one in archive:
            if not one.isfile() or not one.name.endswith(suffix):
                continue
            assert not names or names[-1] < one.name, f"{path}: {one.name} is not in order"
            names.append(one.name)
            target = folder / one.name
            target.parent.mkdir(parents=True, exist_ok=True)
            content = archive.extractfile(one)
            assert content is not None
            with target.open("wb") as file:
                shutil.copyfileobj(content, file)
            if len(names) == most:
                break
    return names
