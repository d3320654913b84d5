"""Field types that several models of a scene share."""

from typing import Annotated, TypeAlias

from pydantic import AfterValidator

Vector: TypeAlias = tuple[float, float, float]


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = sum(value * value for value in quaternion) ** 0.5
    if not 0.999 < length < 1.001:
        raise ValueError("expected a unit quaternion (x, y, z, w)")
    x, y, z, w = (value / length for value in quaternion)
    return (x, y, z, w)


Quaternion: TypeAlias = Annotated[tuple[float, float, float, float], AfterValidator(_unit)]
