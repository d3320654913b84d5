"""Configuration of the evaluation: the only source of its defaults and ranges."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from lidar_core.config import Config

Edge = Annotated[float, Field(ge=0, le=1e5)]


class EvaluationConfig(Config):
    """Conditions for found targets and sightings, and groups of the results."""

    removed: ClassVar[Mapping[str, str]] = {
        "order": "OSPA and GOSPA have the order 2",
    }
    gate: float = Field(
        default=1.0,
        gt=0,
        le=1000,
        description="An estimate further from every target's centre is false [m]; also the cutoff c"
        " of OSPA and GOSPA.",
    )
    max_distance: float = Field(
        default=20.0,
        gt=0,
        le=1e5,
        description="Targets further from the sensor need not be found [m].",
    )
    min_hits: int = Field(
        default=3,
        ge=0,
        le=1_000_000,
        description="Targets with fewer points need not be found (count, no unit).",
    )
    burn_in_scans: int = Field(
        default=0,
        ge=0,
        le=1_000_000,
        description="First scans, in which no target need be found (count, no unit).",
    )
    time_tolerance: float = Field(
        default=1e-4,
        ge=0,
        le=10,
        description="Estimates belong to the truth of a time at most this far away [s].",
    )
    distance_edges: tuple[Edge, ...] = Field(
        default=tuple(float(edge) for edge in range(0, 51, 5)),
        min_length=2,
        description="Edges of the groups by distance from the sensor [m]; a group holds its far"
        " edge.",
    )
    band: float = Field(
        default=0.95,
        gt=0,
        lt=1,
        description="Probability inside the band of a consistent NEES or NIS (no unit). Source:"
        " Bar-Shalom et al., 2001, sec. 5.4.",
    )

    @model_validator(mode="after")
    def _edges_grow(self) -> Self:
        edges = self.distance_edges
        if any(far <= near for near, far in pairwise(edges)):
            raise ValueError("distance_edges: expected each edge greater than the one before")
        return self
