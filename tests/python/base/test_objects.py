"""Objects at one time: rows, short texts, plain values and tables."""

import json
import sys
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from lidar_core import MissingExtraError, TrackKind, objects
from lidar_core.circles import CircleElements, ShapeElements
from lidar_core.flying import FlyingDetections, Tracks
from lidar_core.fusion import Measurement, MultiTargetTracker
from lidar_core.sim import ObjectTruth, TargetTruth
from lidar_core.viz import Objects


def filled(kind, rows):
    """An object of a class, with different numbers in every array."""
    rng = np.random.default_rng(5)
    numbers, hits = np.arange(rows, dtype=np.int64), np.ones(rows, bool)
    vector, plane, scalar = (rng.normal(size=(rows, *shape)) for shape in ((3,), (2,), ()))
    squares = {n: rng.normal(size=(rows, n, n)) for n in (3, 5, 7, 9)}
    at = 1_500_000_000
    make = {
        Tracks: lambda: Tracks(
            *(numbers, vector, vector, vector, at, vector, squares[9], numbers, scalar, scalar),
            numbers.astype(np.uint8),
            rng.random((rows, 5)),
        ),
        FlyingDetections: lambda: FlyingDetections(
            vector, squares[3], scalar, vector, numbers, scalar, numbers
        ),
        CircleElements: lambda: CircleElements(
            *(numbers, plane, plane, scalar, squares[5], scalar, numbers, hits, scalar, scalar),
            numbers.astype(np.uint8),
            rng.random((rows, 5)),
            at,
        ),
        ShapeElements: lambda: ShapeElements(
            numbers,
            numbers.astype(np.uint8),
            plane,
            plane,
            scalar,
            plane,
            rng.normal(size=(rows, 2, 2)),
            squares[7],
            scalar,
            numbers,
            hits,
            at,
        ),
        TargetTruth: lambda: TargetTruth(numbers, vector, vector, scalar, numbers, numbers, hits),
        ObjectTruth: lambda: ObjectTruth(
            numbers, ("box",) * rows, plane, plane, scalar, numbers, numbers
        ),
        Objects: lambda: Objects(numbers, vector, vector, squares[3], vector),
    }
    return make[kind]()


KINDS = (Tracks, FlyingDetections, CircleElements, ShapeElements, TargetTruth, ObjectTruth, Objects)


@pytest.mark.parametrize("rows", [0, 1, 2000])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_kind_has_rows_a_short_text_and_tables(kind, rows):
    found = filled(kind, rows)
    assert isinstance(found, objects.ObjectTable)
    assert len(found) == rows
    assert repr(found).startswith(f"{kind.__name__}({rows} rows")
    assert len(repr(found)) < 100
    values = json.loads(json.dumps(found.to_dict()))
    assert set(values) == {one.name for one in fields(kind)}
    columns = found.to_columns()
    assert all(column.shape == (rows,) for column in columns.values())
    table = pytest.importorskip("pyarrow").table(columns)
    assert found.to_arrow().equals(table)


def test_columns_are_named_as_in_the_tables_of_runs():
    tracks = filled(Tracks, 3)
    columns = tracks.to_columns()
    np.testing.assert_array_equal(columns["y"], tracks.position[:, 1])
    np.testing.assert_array_equal(columns["az"], tracks.acceleration[:, 2])
    np.testing.assert_array_equal(columns["cov_x_vy"], tracks.covariance[:, 0, 4])
    np.testing.assert_array_equal(columns["extent_2"], tracks.extent[:, 2])
    assert columns["stamp_ns"].tolist() == [1_500_000_000] * 3
    assert "cov_vy_x" not in columns
    np.testing.assert_array_equal(columns["p_ground"], tracks.kind_probability[:, TrackKind.GROUND])
    circles = filled(CircleElements, 3)
    np.testing.assert_array_equal(
        circles.to_columns()["cov_radius_radius"], circles.covariance[:, 4, 4]
    )


def test_targets_of_fusion_are_of_the_family():
    tracker = MultiTargetTracker()
    for k in range(5):
        scan = [Measurement(k * 10**8, "lidar", [x, 0.1 * k]) for x in (3.0, 8.0)]
        tracker.process(k * 10**8, scan, source="lidar")
    tracks = tracker.tracks_at(4 * 10**8)
    assert isinstance(tracks, objects.ObjectTable)
    assert tracks.to_columns()["id"].tolist() == [0, 1]
    assert repr(tracks) == "TargetTracks(2 rows, id=[0, 1], stamp_ns=400000000)"


def test_pandas_is_used_where_it_is_there(monkeypatch):
    tracks = filled(Tracks, 2)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="pip install pandas"):
        tracks.to_pandas()
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    assert list(tracks.to_pandas()) == list(tracks.to_columns())
