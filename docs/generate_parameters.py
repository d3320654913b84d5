"""Write docs/parameters.md from the configuration models: python docs/generate_parameters.py."""

from pathlib import Path

from pydantic import BaseModel

from lidar_core.parameters import MODELS, Parameter, model_named, models_within, parameters_of

PAGE = Path(__file__).parent / "parameters.md"
USED_BY = {
    "batch": "`lidar-core batch`",
    "circle_dataset": "`circles.dataset`, `circles.make_samples`",
    "circles": "`lidar_core.circles.CirclePipeline` and its parts",
    "evaluation": "`lidar-core demo`, `lidar_core.evaluation`",
    "flight": "`lidar_core.sim`: a target in a real scan",
    "flying": "`lidar-core detect --config`, `lidar_core.flying.FlyingObjectDetector`",
    "fusion": "`lidar-core fuse`, `lidar_core.fusion.TargetFilter`, `lidar_core.fusion.run`",
    "fusion_autoferry": "`lidar-core fuse`, `lidar_core.fusion.read_autoferry`",
    "fusion_bag": "`lidar-core fuse`, `lidar_core.fusion.read_bag`",
    "fusion_many": "`lidar-core fuse`, `lidar_core.fusion.MultiTargetTracker`",
    "fusion_table": "`lidar-core fuse`, `lidar_core.fusion.read_measurements`",
    "live": "`lidar-core live --stream`, `lidar_core.live`",
    "overflight": "`lidar_core.sim.overfly`, `lidar-core reproduce`",
    "pose_noise": "`lidar_core.sim.NoisyPoses`, `lidar-core reproduce`",
    "poses": "`lidar-core detect`, `lidar_core.io.posed_scans`",
    "read": "`lidar-core info`, `lidar-core detect`, `lidar_core.io.open_recording`",
    "scene": "`lidar-core simulate`, `lidar_core.sim.simulate`",
    "steering": "`lidar_core.sim.SteeredSensor`, `lidar-core reproduce`",
}
INTRODUCTION = """\
# Parameters

Made from the configuration models, which are the only source of defaults, ranges and units.
`lidar-core config init` writes a file that holds all of them with their meaning,
`lidar-core config show FILE` tells what a file changes, `lidar-core config schema` prints the JSON
Schema. In a file, a table such as `[voxel_map]` holds the parameters of the model that the
parameter `voxel_map` is of; `"none"` stands for no value.
"""
LONGEST_DEFAULT = 40


def page() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    for name in MODELS:
        lines += [f"## {name}", "", f"Used by {USED_BY[name]}.", ""]
        for model in models_within(model_named(name)):
            lines += _section(model)
    return "\n".join(lines)


def _section(model: type[BaseModel]) -> list[str]:
    rows = [_row(parameter) for parameter in parameters_of(model)]
    head = ["| Parameter | Type | Default | Range | Meaning |", "|---|---|---|---|---|"]
    text = "\n".join(line.strip() for line in (model.__doc__ or "").strip().splitlines())
    return [f"### {model.__name__}", "", text, "", *head, *rows, ""]


def _row(parameter: Parameter) -> str:
    default = parameter.default
    if len(default) > LONGEST_DEFAULT:
        default = f"{default[:LONGEST_DEFAULT].rstrip(', ')} ..."
    cells = (
        f"`{parameter.name}`", f"`{parameter.type}`", f"`{default}`",
        f"`{parameter.range}`" if parameter.range else "", parameter.description,
    )  # fmt: skip
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
