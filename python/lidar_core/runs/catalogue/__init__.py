"""Tables over many runs: all tracks with the names of their recordings, events, and queries."""

from lidar_core.runs.catalogue.objects import (
    EVENTS,
    OBJECTS,
    events_of,
    has_objects,
    objects_and_events,
    objects_of,
)
from lidar_core.runs.catalogue.query import absent_texts, columns_named, matching_rows, read_table

__all__ = [
    "EVENTS",
    "OBJECTS",
    "absent_texts",
    "columns_named",
    "events_of",
    "has_objects",
    "matching_rows",
    "objects_and_events",
    "objects_of",
    "read_table",
]


def __dir__() -> list[str]:
    return __all__
