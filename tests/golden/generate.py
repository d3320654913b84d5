"""Write the golden files again: make golden."""

import json
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from golden import digest
from golden.recordings_replay import READ
from golden.scenes import FILES, played, read
from lidar_core.parameters import MODELS, model_named


def config_schemas() -> dict[str, Any]:
    """JSON Schema of every model that a file or a command line fills."""
    return {name: model_named(name).model_json_schema() for name in sorted(MODELS)}


def replay(
    file: str, scenes: Iterable[str], play: Callable[[str], dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Digests of all scenes of a file, under the names that it has for them; says what changed."""
    known = digest.golden(file) if (digest.FOLDER / f"{file}.json").exists() else {}
    renamed, found = digest.renames(), {}
    for scene in scenes:
        before = known.get(scene, {})
        found[scene] = digest.under_old_names(play(scene), before, renamed)
        for line in digest.differences(f"{file}: {scene}", before, found[scene]) if before else ():
            sys.stdout.write(f"{line}\n")
    return found


def main() -> None:
    """Write all files; those of recordings only where `LIDAR_CORE_DATA` names their folder."""
    text = json.dumps(config_schemas(), indent=1, sort_keys=True)
    (digest.HERE / "config.schema.json").write_text(text + "\n", encoding="utf-8")
    for file, scenes in FILES.items():
        digest.write(file, replay(file, scenes, lambda scene, file=file: played(file, scene, 1)))
    data = os.environ.get("LIDAR_CORE_DATA")
    if data is None:
        sys.stdout.write("LIDAR_CORE_DATA is not set: replay/recordings.json is left as it is\n")
    else:
        digest.write("recordings", replay("recordings", READ, lambda name: read(name, Path(data))))


if __name__ == "__main__":
    main()
