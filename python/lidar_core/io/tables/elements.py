"""Columns and rows that the tables of circles and of other shapes share."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from lidar_core.io.tables.covariance import covariance_titles, upper_triangle
from lidar_core.objects import CircleElements, ShapeElements


def element_columns(
    state: Sequence[str], *, texts: Sequence[str] = (), more: Sequence[str] = ()
) -> dict[str, type]:
    """Column types by title: time, ID, frame; texts; state and further numbers; age, covariance."""
    return {
        "t_ns": int,
        "track_id": int,
        "frame_id": str,
        **dict.fromkeys(texts, str),
        **dict.fromkeys((*state, *more), float),
        "age": float,
        "visible": int,
        **dict.fromkeys(covariance_titles(state), float),
    }


def element_rows(
    maps: Iterable[CircleElements | ShapeElements],
    frame_id: str,
    size: int,
    values: Callable[[Any, int], Sequence[Any]],
) -> Iterator[Sequence[Any]]:
    """Rows of `element_columns`; `values` gives the texts and numbers of an element by its row."""
    for state in maps:
        covariance = upper_triangle(state.covariance, size).tolist()
        for row, number in enumerate(state.id.tolist()):
            yield (
                int(state.stamp_ns),
                number,
                frame_id,
                *values(state, row),
                float(state.age[row]),
                int(state.visible[row]),
                *covariance[row],
            )
