"""Types and limits that configuration models of flying objects share."""

from typing import Annotated

from pydantic import AfterValidator

Corner = tuple[float, float, float]
MOST_SCANS = 1_000_000
"""Longest burn-in or learning, more than a day."""
MOST_POINTS = 4_000_000
"""A scan has no more."""


def _ordered(box: tuple[Corner, Corner]) -> tuple[Corner, Corner]:
    if not all(low < high for low, high in zip(*box, strict=True)):
        raise ValueError("expected a lower corner, then an upper corner")
    return box


Box = Annotated[tuple[Corner, Corner], AfterValidator(_ordered)]
