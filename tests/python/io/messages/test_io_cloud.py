"""Packed clouds against a slow reading with `struct`, and the conventions detected on them."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_core.errors import FormatError, LimitError
from lidar_core.io.messages.cloud import CloudDecoder, Field, Layout, unpack
from lidar_core.io.options import ReadOptions
from lidar_core.io.records import Findings

STRUCT_CODES = {
    "i1": "b",
    "u1": "B",
    "i2": "h",
    "u2": "H",
    "i4": "i",
    "u4": "I",
    "f4": "f",
    "f8": "d",
}
BASE_NS = 1_700_000_000_000_000_000


@st.composite
def packed_clouds(draw):
    """A layout with random types, order, gaps, padding and byte order, and its bytes."""
    fields, offset = [], draw(st.integers(0, 3))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring", "_", ""]))
    for name in names:
        code = draw(st.sampled_from(sorted(STRUCT_CODES)))
        length = draw(st.sampled_from([0, 1, 1, 1, 3]))
        fields.append(Field(name, code, offset, length))
        offset += np.dtype(code).itemsize * max(length, 1) + draw(st.integers(0, 5))
    step = offset + draw(st.integers(0, 4))
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    row_step = width * step + draw(st.integers(0, 7))
    layout = Layout(fields, step, row_step, width, height, draw(st.booleans()))
    seed = draw(st.integers(0, 2**32 - 1))
    data = np.random.default_rng(seed).integers(0, 256, height * row_step, dtype=np.uint8)
    return layout, data


def slow_values(layout, data, field, row, column):
    """The values of one field of one point, read with `struct`."""
    order = ">" if layout.is_bigendian else "<"
    start = row * layout.row_step + column * layout.point_step + field.offset
    code = f"{order}{max(field.length, 1)}{STRUCT_CODES[field.code]}"
    return struct.unpack_from(code, data.tobytes(), start)


@given(packed_clouds())
def test_unpacking_equals_struct(cloud):
    layout, data = cloud
    rows = unpack(data, layout, place="test", max_points=1000)
    assert rows.shape == (layout.height, layout.width)
    for field in layout.fields:
        if field.name in ("", "_"):
            assert field.name not in rows.dtype.names
            continue
        for row in range(layout.height):
            for column in range(layout.width):
                expected = slow_values(layout, data, field, row, column)
                got = np.atleast_1d(rows[field.name][row, column])
                np.testing.assert_array_equal(got, expected)


def test_the_last_row_needs_no_padding():
    layout = Layout([Field("x", "f4", 0)], 4, 10, 2, 2, is_bigendian=False)
    data = np.arange(18, dtype=np.uint8)
    assert unpack(data, layout, place="test", max_points=9).shape == (2, 2)
    with pytest.raises(FormatError, match=r"17 bytes of data, but the layout needs 18"):
        unpack(data[:17], layout, place="test", max_points=9)


@pytest.mark.parametrize(
    ("layout", "text"),
    [
        (Layout([Field("x", "f4", 2)], 4, 4, 1, 1, False), "ends beyond the point step"),
        (Layout([Field("x", "f4", 0)], 4, 3, 2, 2, False), "row_step 3, but 2 points need 8"),
        (Layout([Field("x", "u1", 0), Field("x", "u1", 1)], 4, 4, 1, 1, False), "appears twice"),
        (Layout([], 0, 0, 1, 1, False), "point step of 0 bytes"),
    ],
)
def test_broken_layouts_are_refused(layout, text):
    with pytest.raises(FormatError, match=f"^here: .*{text}"):
        unpack(np.zeros(64, np.uint8), layout, place="here", max_points=9)


def test_too_many_points_name_the_option():
    layout = Layout([Field("x", "f4", 0)], 4, 4 * 2**31, 2**31, 2**31, is_bigendian=False)
    with pytest.raises(LimitError, match="limit 4000000; raise it with max_points"):
        unpack(np.zeros(4, np.uint8), layout, place="here", max_points=4_000_000)


def rows_of(points, **extra):
    points = np.asarray(points, np.float32)
    types = [(axis, "<f4") for axis in "xyz"] + [(k, v.dtype) for k, v in extra.items()]
    rows = np.zeros(points.shape[:-1], types)
    for axis, name in enumerate("xyz"):
        rows[name] = points[..., axis]
    for name, values in extra.items():
        rows[name] = values
    return rows


def decode(rows, stamp_ns=BASE_NS, **options):
    findings = Findings()
    decoder = CloudDecoder("/points", ReadOptions(**options), findings)
    return decoder.scan(rows, stamp_ns, "lidar", place="here"), findings


CLOUD = np.array([[[1, 2, 3], [0, 0, 0]], [[4, 5, 6], [np.nan, 1, 1]]], np.float32)


def test_zero_rows_are_rays_without_return():
    scan, findings = decode(rows_of(CLOUD))
    assert scan.points.shape == (2, 2, 3)
    np.testing.assert_array_equal(scan.no_return, [False, True, False, False])
    np.testing.assert_array_equal(np.isnan(scan.points).all(axis=2), [[False, True], [False, True]])
    assert findings.no_return["/points"] == "zero: 1 of 4 rows of a scan are zeros"


def test_a_near_point_that_repeats_is_told_as_a_placeholder():
    """It stays a point: the detector leaves it out, because it is near."""
    points = np.random.default_rng(0).uniform(2, 9, (1000, 3)).astype(np.float32)
    points[::3] = 0.1
    points[1] = np.nan
    scan, findings = decode(rows_of(points))
    assert findings.no_return["/points"] == (
        "none marked: 334 of 1000 rows of a scan are the point (0.1, 0.1, 0.1), probably rays"
        " without return; `detect` uses points from sensor.min_range on"
    )
    assert scan.no_return is None
    assert np.isfinite(scan.points).all(axis=1).sum() == 999


def test_coarse_coordinates_and_points_far_away_are_no_placeholders():
    rng = np.random.default_rng(0)
    coarse = np.round(rng.uniform(1, 9, (5000, 3)) * 8) / 8
    walls = rng.uniform(2, 9, (5000, 3))
    walls[::3] = 120.0
    for points in (coarse, walls, np.full((9, 3), 0.1), np.full((50, 3), np.nan)):
        _, findings = decode(rows_of(points))
        assert findings.no_return["/points"].startswith("none seen")
    marked = np.full((50, 3), 0.1)
    marked[:30] = 0
    _, findings = decode(rows_of(marked))
    assert findings.no_return["/points"].startswith("zero: 30 of 50")


def test_nan_rows_are_rays_without_return_in_an_organised_cloud_only():
    cloud = CLOUD.copy()
    cloud[0, 1] = np.nan
    scan, findings = decode(rows_of(cloud))
    np.testing.assert_array_equal(scan.no_return, [False, True, False, True])
    assert findings.no_return["/points"].startswith("nan: 2 of 4 rows")
    scan, findings = decode(rows_of(cloud.reshape(-1, 3)))
    assert scan.no_return is None
    assert findings.no_return["/points"].startswith("none seen")


@pytest.mark.parametrize(
    ("choice", "mask"),
    [("zero", [0, 1, 0, 0]), ("nan", [0, 0, 0, 1]), ("none", None)],
)
def test_the_option_overrides_the_detection(choice, mask):
    scan, findings = decode(rows_of(CLOUD), no_return=choice)
    if mask is None:
        assert scan.no_return is None
    else:
        np.testing.assert_array_equal(scan.no_return, np.array(mask, bool))
    assert findings.no_return["/points"] == f"{choice}, set by the option no_return"


def test_the_mark_of_2d_scans_is_said_to_mark_nothing_in_a_cloud():
    scan, findings = decode(rows_of(CLOUD), no_return="max")
    assert scan.no_return is None
    assert findings.no_return["/points"].endswith("marks nothing in a 3D cloud, only in 2D scans")


def test_the_convention_is_kept_for_later_scans():
    decoder = CloudDecoder("/points", ReadOptions(), Findings())
    decoder.scan(rows_of(CLOUD), 0, "lidar", place="here")
    later = decoder.scan(rows_of(np.full((2, 2, 3), np.nan)), 0, "lidar", place="here")
    np.testing.assert_array_equal(later.no_return, [False] * 4)


@pytest.mark.parametrize(
    ("name", "values", "verdict"),
    [
        ("t", np.array([0, 99_000_000], np.uint32), "t:ns:start"),
        ("offset_time", np.array([5, 99_000_000], np.uint32), "offset_time:ns:start"),
        ("time", np.array([-0.1, 0.0], np.float32), "time:s:start"),
        ("time", np.array([0.0, 0.05], np.float64), "time:s:start"),
        ("timestamp", np.array([0.0, 99_000], np.float64), "timestamp:us:start"),
        ("timestamp", np.array([1.7e9, 1.7e9 + 0.09], np.float64), "timestamp:s:absolute"),
        ("timestamp", np.array([0, 90_000_000], np.int64) + BASE_NS, "timestamp:ns:absolute"),
        ("t", np.array([1.7e15, 1.7e15 + 9e4], np.float64), "t:us:absolute"),
    ],
)
def test_point_times_are_detected(name, values, verdict):
    scan, findings = decode(rows_of([[1, 1, 1], [2, 2, 2]], **{name: values}))
    assert findings.point_time["/points"].startswith(f"{verdict} detected: field {name}")
    unit = {"s": 1e9, "us": 1e3, "ns": 1}[verdict.split(":")[1]]
    base = 0 if verdict.endswith("absolute") else BASE_NS
    expected = [base + round(float(value) * unit) for value in values]
    np.testing.assert_allclose(scan.point_time_ns - BASE_NS, np.array(expected) - BASE_NS, atol=300)
    assert scan.stamp_ns == min(BASE_NS, scan.point_time_ns.min())


def test_integer_times_are_exact():
    values = np.array([BASE_NS + 1, BASE_NS + 90_000_003], np.uint64)
    scan, _ = decode(rows_of([[1, 1, 1], [2, 2, 2]], timestamp=values))
    np.testing.assert_array_equal(scan.point_time_ns, values)


def test_stated_reference_end():
    values = np.array([0, 100_000], np.uint32)
    scan, findings = decode(rows_of([[1, 1, 1], [2, 2, 2]], t=values), point_time="t:us:end")
    np.testing.assert_array_equal(scan.point_time_ns, [BASE_NS - 100_000_000, BASE_NS])
    assert scan.stamp_ns == BASE_NS - 100_000_000
    assert findings.point_time["/points"] == "t:us:end, set by the option point_time"


def test_times_that_fit_no_unit_are_ignored_in_words():
    values = np.array([0, 7_000_000_000_000], np.int64)
    scan, findings = decode(rows_of([[1, 1, 1], [2, 2, 2]], t=values))
    assert scan.point_time_ns is None
    assert "fits no unit; state it as field:unit:reference" in findings.point_time["/points"]


def test_a_missing_time_field_names_those_found():
    with pytest.raises(FormatError, match=r"here: no field 'stamps' .*found x, y, z"):
        decode(rows_of([[1, 1, 1]]), point_time="stamps:ns:start")


def test_missing_coordinates_name_the_fields_found():
    rows = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("velocity", "<f4")])
    with pytest.raises(FormatError, match="here: no field z; found x, y, velocity"):
        decode(rows)


def test_intensity_and_ring():
    rows = rows_of([[1, 1, 1]], reflectivity=np.array([7], np.uint16), channel=np.array([3], "u1"))
    scan, _ = decode(rows)
    assert (scan.intensity.dtype, scan.ring.dtype) == (np.float32, np.uint16)
    assert (scan.intensity[0], scan.ring[0]) == (7, 3)
