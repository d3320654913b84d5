"""Speed and memory of the guide, from what the benches left: `make figures`.

`collect` reads criterion's results and the files that benches and peers wrote into a folder, and
writes `benches/results/<cpu>.json`. `write` writes the tables of all such files into README and
guide, between `<!-- figures: NAME -->` and `<!-- end of figures -->`. `check` fails where a table
differs from that. The tables are in `figure_tables`.
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

from figure_tables.others import filters, peers, tracking
from figure_tables.results import ROOT, Machine, collect, read_machines
from figure_tables.sizes import growth, memory
from figure_tables.speed import speed, update

PAGES = [
    ROOT / "README.md",
    ROOT / "docs/performance.md",
    ROOT / "docs/performance-beside-others.md",
    ROOT / "docs/fusion.md",
]
BLOCK = re.compile(r"(<!-- figures: ([a-z-]+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
TABLES: dict[str, Callable[[list[Machine]], str]] = {
    "speed": speed,
    "update": update,
    "rays": peers("rays into the map"),
    "clusters": peers("clusters"),
    "simulated-rays": peers("simulated"),
    "filters": filters,
    "tracking": tracking,
    "growth": growth,
    "memory": memory,
}


def page_with_tables(text: str, machines: list[Machine]) -> str:
    """A page with the tables as the results have them.

    Raises
    ------
    KeyError
        The page asks for a table that does not exist.
    """

    def table(found: re.Match[str]) -> str:
        return f"{found[1]}{TABLES[found[2]](machines)}\n{found[3]}"

    return BLOCK.sub(table, text)


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    collecting = tasks.add_parser("collect", help="write benches/results/<cpu>.json")
    collecting.add_argument("criterion", type=Path, help="criterion's folder, target/criterion")
    collecting.add_argument("folder", type=Path, help="what benches and peers left")
    tasks.add_parser("write", help="write the tables of README and guide")
    tasks.add_parser("check", help="fail where a table is not as the results have it")
    chosen = parser.parse_args()
    if chosen.task == "collect":
        path = collect(chosen.criterion, chosen.folder)
        print(f"{path.relative_to(ROOT)} written")
        return
    machines = read_machines()
    pages = {page: page.read_text(encoding="utf-8") for page in PAGES}
    changed = [page for page, text in pages.items() if page_with_tables(text, machines) != text]
    if chosen.task == "check" and changed:
        names = ", ".join(str(page.relative_to(ROOT)) for page in changed)
        sys.exit(f"{names}: tables differ from benches/results; run `make figures`, do not edit")
    for page in changed:
        page.write_text(page_with_tables(pages[page], machines), encoding="utf-8")


if __name__ == "__main__":
    main()
