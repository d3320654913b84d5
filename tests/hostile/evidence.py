"""Counts of what was attacked, added up over all runs, and the page that shows them."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "evidence" / "evidence.json"
PAGE = ROOT / "docs" / "evidence" / "index.md"
BEGIN, END = "<!-- counts -->\n", "<!-- end of counts -->"
GOOD = ("ok", "typed")


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


def table(known: Mapping[str, Mapping[str, Mapping[str, int]]]) -> str:
    """The counts as a table of the guide."""
    rows = [
        "| Attack | Format | Files | Read | Refused | Ended badly |",
        "|---|---|---|---|---|---|",
    ]
    for attack, formats in sorted(known.items()):
        for name, counts in sorted(formats.items()):
            bad = sum(count for kind, count in counts.items() if kind not in GOOD)
            told = (sum(counts.values()), counts.get("ok", 0), counts.get("typed", 0), bad)
            rows.append(f"| {attack} | `{name}` | " + " | ".join(f"{n:,}" for n in told) + " |")
    return "\n".join(rows) + "\n"


def shown(page: str, known: Mapping[str, Mapping[str, Mapping[str, int]]]) -> str:
    """The page with these counts."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "\n" + table(known) + "\n" + END + rest.split(END)[1]


def main() -> None:
    PAGE.write_text(shown(PAGE.read_text(), json.loads(FILE.read_text())))


if __name__ == "__main__":
    main()
