"""Elements of the map with other shapes than circles."""

from typing import Any

from numpy.typing import NDArray

from lidar_core.objects import ShapeElements


def shape_elements_of(arrays: tuple[NDArray[Any], ...], stamp_ns: int) -> ShapeElements:
    """Return the confirmed elements of the core's result."""
    *columns, confirmed = arrays
    number, kind, mean, covariance, ends, age, seen_ns, visible = (
        column[confirmed] for column in columns
    )
    return ShapeElements(
        id=number,
        kind=kind,
        center=mean[:, 0:2],
        velocity=mean[:, 2:4],
        heading=mean[:, 4],
        half_size=mean[:, 5:7],
        ends=ends,
        covariance=covariance,
        age=age,
        seen_ns=seen_ns,
        visible=visible,
        stamp_ns=stamp_ns,
    )
