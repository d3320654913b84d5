"""Write the golden files again: make golden."""

import json
import sys
from typing import Any

from golden import digest
from golden.scenes import FILES, played, threads_of
from lidar_core.parameters import MODELS, model_named


def config_schemas() -> dict[str, Any]:
    """JSON Schema of every model that a file or a command line fills."""
    return {name: model_named(name).model_json_schema() for name in sorted(MODELS)}


def replay(file: str) -> dict[str, dict[str, Any]]:
    """Digests of all scenes of a file, under the names that it has for them."""
    known = digest.golden(file) if (digest.FOLDER / f"{file}.json").exists() else {}
    renamed, scenes = digest.renames(), {}
    for scene in FILES[file]:
        before = known.get(scene, {})
        got = played(file, scene, threads_of(file, scene)[0])
        scenes[scene] = digest.under_old_names(got, before, renamed)
        for line in digest.differences(f"{file}: {scene}", before, scenes[scene]):
            if before:
                sys.stdout.write(f"{line}\n")
    return scenes


def main() -> None:
    """Write all files; say what has changed."""
    text = json.dumps(config_schemas(), indent=1, sort_keys=True)
    (digest.HERE / "config.schema.json").write_text(text + "\n", encoding="utf-8")
    for file in FILES:
        digest.write(file, replay(file))


if __name__ == "__main__":
    main()
