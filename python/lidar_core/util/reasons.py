"""Kinds of reasons why scans are not processed: texts that differ only in their numbers."""

import re
from collections.abc import Iterable

_VALUE = re.compile(r"(?<![\w/])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")  # no part of a name


def kind_of(reason: str) -> str:
    """Return a reason without its numbers, which are stamps and sizes of one scan."""
    return _VALUE.sub("#", reason)


def first_of_kind(reasons: Iterable[str], reason: str) -> str:
    """Return the first of the known reasons that has the kind of this one; else this one."""
    kind = kind_of(reason)
    return next((known for known in reasons if kind_of(known) == kind), reason)
