"""Write the golden files again: python tests/golden/generate.py."""

import json
from pathlib import Path
from typing import Any

from lidar_core.parameters import MODELS, model_named

HERE = Path(__file__).parent


def config_schemas() -> dict[str, Any]:
    """JSON Schema of every model that a file or a command line fills."""
    return {name: model_named(name).model_json_schema() for name in sorted(MODELS)}


def main() -> None:
    """Write all files."""
    text = json.dumps(config_schemas(), indent=1, sort_keys=True)
    (HERE / "config.schema.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
