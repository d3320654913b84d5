"""Counts of what was attacked, added up over all runs, and the page that shows them.

`python -m hostile.evidence` writes the page again. With `--mended ATTACK NAME` it first notes that
all bugs which this attack has found there are mended, and that tests hold them.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "evidence" / "evidence.json"
PAGE = ROOT / "docs" / "evidence" / "index.md"
BEGIN, END = "<!-- counts -->\n", "<!-- end of counts -->"
GOOD = ("ok", "typed")
MENDED = "mended"
"""How a file ended badly whose bug is mended and has become a test."""


def add(attack: str, outcomes: Mapping[str, Mapping[str, int]], file: Path = FILE) -> None:
    """Add the outcomes of one run, by format, to those of earlier ones."""
    known = json.loads(file.read_text()) if file.exists() else {}
    of_attack = known.setdefault(attack, {})
    for name, counts in outcomes.items():
        total = Counter(of_attack.get(name, {})) + Counter(counts)
        of_attack[name] = dict(sorted(total.items()))
    known[attack] = dict(sorted(of_attack.items()))
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")


def mend(attack: str, name: str, file: Path = FILE) -> int:
    """Note that the bugs which an attack has found in a format are mended; how many they were."""
    known = json.loads(file.read_text())
    counts = known[attack][name]
    open_ones = {kind for kind in counts if kind not in (*GOOD, MENDED)}
    count = sum(counts.pop(kind) for kind in open_ones)
    known[attack][name] = dict(sorted((Counter(counts) + Counter({MENDED: count})).items()))
    file.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")
    return count


def table(known: Mapping[str, Mapping[str, Mapping[str, int]]]) -> str:
    """The counts as a table of the guide."""
    rows = [
        "| Attack | Format | Files | Read | Refused | Bugs, mended | Bugs, open |",
        "|---|---|---|---|---|---|---|",
    ]
    for attack, formats in sorted(known.items()):
        for name, counts in sorted(formats.items()):
            well = [counts.get(kind, 0) for kind in (*GOOD, MENDED)]
            told = (sum(counts.values()), *well, sum(counts.values()) - sum(well))
            rows.append(f"| {attack} | `{name}` | " + " | ".join(f"{n:,}" for n in told) + " |")
    return "\n".join(rows) + "\n"


def shown(page: str, known: Mapping[str, Mapping[str, Mapping[str, int]]]) -> str:
    """The page with these counts."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "\n" + table(known) + "\n" + END + rest.split(END)[1]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m hostile.evidence", description=__doc__)
    parser.add_argument(
        "--mended", nargs=2, action="append", default=[], metavar=("ATTACK", "NAME")
    )
    for attack, name in parser.parse_args().mended:
        print(f"{attack}, {name}: {mend(attack, name)} mended")
    PAGE.write_text(shown(PAGE.read_text(), json.loads(FILE.read_text())))


if __name__ == "__main__":
    main()
