"""Tables of what grows with the input: time and memory."""

from figure_tables.cells import caption, number_text
from figure_tables.results import Machine


def growth(machines: list[Machine]) -> str:
    """Power of the time in what grows."""
    titles = {
        "rays": "rays into the map",
        "voxel": "voxels per metre, same rays",
        "range": "range [m], same rays",
        "points": "clustered points",
        "tracks": "tracks",
        "extent": "length of the map [m], one scan and removal of islands",
    }
    parts = []
    for machine in machines:
        found = machine["figures"].get("scaling", {})
        lines = [f"| {caption(machine)} | Sizes | Time [ms] | Power |", "|---|---|---|---|"]
        for name, title in titles.items():
            if row := found.get(name):
                sizes = f"{row['least']:,g} to {row['most']:,g}"
                times = f"{number_text(row['least_ms'])} to {number_text(row['most_ms'])}"
                lines.append(f"| {title} | {sizes} | {times} | {row['power']:.2f} |")
        parts.append("\n".join(lines) if found else "Not measured.")
    return "\n\n".join(parts)


def memory(machines: list[Machine]) -> str:
    """Memory of map and detector."""
    parts = []
    for machine in machines:
        found = machine["figures"].get("memory", {})
        lines = [
            f"| {caption(machine)} | scene 1 | scene 2 |",
            "|---|---|---|",
            *(
                f"| {title} | "
                + " | ".join(
                    number_text(found.get(f"scene_{scene}", {}).get(key), digits)
                    for scene in (1, 2)
                )
                + " |"
                for title, key, digits in (
                    ("voxels observed", "voxels", 2),
                    ("map [MB]", "map_mb", 2),
                    ("bytes per voxel", "bytes_per_voxel", 2),
                    ("detector with its map [MB]", "held_mb", 3),
                    ("of which in use [MB]", "used_mb", 3),
                    ("allocations per scan, without targets", "allocations_empty", 2),
                    ("[MB]", "allocated_empty_mb", 2),
                    ("allocations per scan, with two targets", "allocations", 2),
                    ("[MB]", "allocated_mb", 2),
                )
            ),
        ]
        parts.append("\n".join(lines) if found else "Not measured.")
    return "\n\n".join(parts)
