"""Archives of the recordings, unpacked by means that every Python 3.11 has."""

import shutil
import tarfile
from pathlib import Path


def unpack(path: Path, folder: Path, *, suffix: str = "", most: int | None = None) -> list[str]:
    """Unpack the first `most` plain files by name, of those that end in `suffix`; their names."""
    with tarfile.open(path) as archive:
        files = {one.name: one for one in archive if one.isfile() and one.name.endswith(suffix)}
        names = sorted(files)[:most]
        for name in names:
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            content = archive.extractfile(files[name])
            assert content is not None
            with target.open("wb") as file:
                shutil.copyfileobj(content, file)
    return names
