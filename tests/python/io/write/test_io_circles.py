"""Circle maps in tables, trajectories and scenes hold what was mapped."""

from dataclasses import dataclass

import numpy as np
import pytest
from circle_states import Circles
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import lidar_core as lc
import lidar_core.io
from lidar_core.circles import ShapeKind
from lidar_core.errors import InputError
from lidar_core.io.tables.circles import COLUMNS, STATE, map_columns
from lidar_core.io.tables.shapes import COLUMNS as SHAPE_COLUMNS
from lidar_core.io.write.circle_scene import ellipse

BASE_NS = 1_700_000_000_000_000_001


def make_circles(numbers, stamp_ns):
    rng = np.random.default_rng(1900 + sum(numbers))
    count = len(numbers)
    root = rng.normal(size=(count, 5, 5))
    return Circles(
        id=np.array(numbers, np.int64),
        center=rng.normal(size=(count, 2)) * 10,
        velocity=rng.normal(size=(count, 2)),
        radius=rng.uniform(0.1, 0.6, count),
        covariance=root @ root.transpose(0, 2, 1),
        age=rng.random(count),
        visible=rng.random(count) < 0.5,
        stamp_ns=stamp_ns,
    )


@pytest.fixture
def maps():
    steps = [([4, 9], 0), ([], 1), ([9], 2)]
    return [make_circles(numbers, BASE_NS + k * 10**8) for numbers, k in steps]


def test_the_map_keeps_what_was_ever_reported_as_it_was_last_in_sight():
    early, late = make_circles([4, 9], BASE_NS), make_circles([4], BASE_NS + 10**10)
    early.visible[:], late.visible[:] = True, False
    early.age[:], late.age[:] = 2.0, 12.0
    late.seen_ns = early.seen_ns[:1]
    table = map_columns([early, make_circles([], BASE_NS + 5 * 10**9), late], "map")
    assert table["track_id"].tolist() == [4, 9]
    assert table["first_ns"].tolist() == [BASE_NS - 2 * 10**9] * 2
    assert table["last_ns"].tolist() == [BASE_NS] * 2
    # Out of sight it may be anywhere: the place is that of the last look.
    assert table["x"].tolist() == early.center[:, 0].tolist()
    assert table["cov_x_x"].tolist() == early.covariance[:, 0, 0].tolist()
    late.visible[:] = True
    assert map_columns([early, late], "map")["x"][0] == late.center[0, 0]
    assert len(map_columns([], "map")["x"]) == 0


@pytest.mark.parametrize("name", ["circles.parquet", "circles.csv"])
def test_a_table_has_a_row_per_element_and_time(tmp_path, maps, name):
    path = lc.io.write_circles_table(tmp_path / name, iter(maps), frame_id="map")
    assert path == tmp_path / name
    table = lc.io.read_columns(path)
    assert list(table) == list(COLUMNS)
    assert table["t_ns"].tolist() == [BASE_NS, BASE_NS, BASE_NS + 2 * 10**8]
    assert table["track_id"].tolist() == [4, 9, 9]
    assert set(table["frame_id"].tolist()) == {"map"}
    for line, (state, k) in enumerate([(maps[0], 0), (maps[0], 1), (maps[2], 0)]):
        values = [*state.center[k], *state.velocity[k], state.radius[k]]
        assert [table[column][line] for column in STATE] == values
        assert table["visible"][line] == state.visible[k]
        assert table["person_probability"][line] == state.person_probability[k]
        assert table["age"][line] == state.age[k]
        assert table["cov_x_x"][line] == state.covariance[k, 0, 0]
        assert table["cov_vy_radius"][line] == state.covariance[k, 3, 4]


def test_no_elements_give_a_table_without_rows(tmp_path):
    for name in ("circles.parquet", "circles.csv"):
        table = lc.io.read_columns(lc.io.write_circles_table(tmp_path / name, []))
        assert {len(column) for column in table.values()} == {0}


def test_a_trajectory_per_element(tmp_path, maps):
    paths = lc.io.write_circles_tum(tmp_path, maps)
    assert [path.name for path in paths] == ["track_4.txt", "track_9.txt"]
    values = np.loadtxt(paths[1])
    np.testing.assert_allclose(values[1, 1:4], [*maps[2].center[0], 0], atol=1e-6)
    assert lc.io.read_columns(tmp_path)["track_id"].tolist() == [4, 9, 9]


def scene(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [item.decoded_message for item in reader.iter_decoded_messages()]


def test_elements_in_mcap_are_scene_entities(tmp_path, maps):
    with lc.io.McapWriter(tmp_path / "a.mcap", tracks_frame="map") as writer:
        for state in maps:
            writer.write_circles(state)
        with pytest.raises(InputError, match="no negative times"):
            writer.write_circles(make_circles([1], -1))
    updates = scene(tmp_path / "a.mcap")
    assert [[item.id for item in update.entities] for update in updates] == [["4", "9"], [], ["9"]]
    entity, state = updates[0].entities[1], maps[0]
    disc = entity.cylinders[0]
    assert (entity.frame_id, entity.texts[0].text) == ("map", "9 person")
    assert updates[0].entities[0].texts[0].text == "4"
    np.testing.assert_array_equal([disc.pose.position.x, disc.pose.position.y], state.center[1])
    assert disc.size.x == 2 * state.radius[1]
    assert disc.pose.orientation.w == 1
    arrow = entity.arrows[0]
    turned = arrow.pose.orientation
    heading = 2 * np.arctan2(turned.z, turned.w)
    velocity = (arrow.shaft_length + arrow.head_length) * np.exp(1j * heading)
    np.testing.assert_allclose([velocity.real, velocity.imag], state.velocity[1])
    around = np.array([[p.x, p.y] for p in entity.lines[0].points]) - state.center[1]
    inverse = np.linalg.inv(state.covariance[1, :2, :2])
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", around, inverse, around), 4)
    positions = lc.io.read_columns(tmp_path / "a.mcap")
    assert positions["track_id"].tolist() == [4, 9, 9]
    np.testing.assert_array_equal(positions["x"][:2], state.center[:, 0])


@dataclass
class Shapes:
    """Elements that are no circles at one time, as the pipeline gives them."""

    id: np.ndarray
    kind: np.ndarray
    center: np.ndarray
    velocity: np.ndarray
    heading: np.ndarray
    half_size: np.ndarray
    ends: np.ndarray
    covariance: np.ndarray
    age: np.ndarray
    visible: np.ndarray
    stamp_ns: int


def make_shapes(stamp_ns):
    """A line, an ellipse and a rectangle."""
    rng = np.random.default_rng(1950)
    root = rng.normal(size=(3, 7, 7))
    return Shapes(
        id=np.array([2, 5, 6]),
        kind=np.array([ShapeKind.LINE, ShapeKind.ELLIPSE, ShapeKind.RECTANGLE], np.uint8),
        center=np.array([[0.0, 1.0], [3.0, 0.0], [4.0, 4.0]]),
        velocity=np.array([[0.0, 0.0], [0.3, 0.4], [0.0, 0.0]]),
        heading=np.array([0.0, np.pi / 2, np.pi / 4]),
        half_size=np.array([[2.0, 0.0], [0.5, 0.2], [2**0.5, 2**0.5]]),
        ends=np.array(
            [[[-2.0, 1.0], [2.0, 1.0]], np.full((2, 2), np.nan), np.full((2, 2), np.nan)]
        ),
        covariance=root @ root.transpose(0, 2, 1),
        age=np.ones(3),
        visible=np.array([True, False, True]),
        stamp_ns=stamp_ns,
    )


@pytest.mark.parametrize("name", ["shapes.parquet", "shapes.csv"])
def test_a_table_has_a_row_per_shape_and_time(tmp_path, name):
    shapes = make_shapes(BASE_NS)
    table = lc.io.read_columns(lc.io.write_shapes_table(tmp_path / name, [shapes, shapes]))
    assert list(table) == list(SHAPE_COLUMNS)
    assert table["kind"].tolist() == 2 * ["line", "ellipse", "rectangle"]
    assert table["track_id"].tolist() == 2 * [2, 5, 6]
    assert (table["x2"][0], table["half_width"][1], table["heading"][2]) == (2, 0.2, np.pi / 4)
    assert np.isnan(np.array(table["x1"][1:3], float)).all()
    assert table["cov_heading_half_width"][1] == shapes.covariance[1, 4, 6]


def test_outlines_in_mcap_are_scene_entities(tmp_path):
    shapes = make_shapes(BASE_NS)
    with lc.io.McapWriter(tmp_path / "a.mcap", tracks_frame="map") as writer:
        writer.write_shapes(shapes)
        with pytest.raises(InputError, match="no negative times"):
            writer.write_shapes(make_shapes(-1))
    line, oval, box = scene(tmp_path / "a.mcap")[0].entities
    assert [item.id for item in (line, oval, box)] == ["2", "5", "6"]
    assert [(p.x, p.y) for p in line.lines[0].points] == [(-2, 1), (2, 1)]
    around = np.array([(p.x, p.y) for p in oval.lines[0].points]) - (3, 0)
    np.testing.assert_allclose((around[:, 0] / 0.2) ** 2 + (around[:, 1] / 0.5) ** 2, 1)
    corners = np.array([(p.x, p.y) for p in box.lines[0].points])
    np.testing.assert_allclose(corners, [(4, 6), (2, 4), (4, 2), (6, 4)])
    assert (len(line.arrows), len(oval.arrows)) == (0, 1)


@given(st.integers(0, 500))
def test_an_ellipse_lies_where_the_mahalanobis_distance_says(seed):
    rng = np.random.default_rng(2900 + seed)
    root = rng.normal(size=(2, 2))
    covariance = root @ root.T + 1e-3 * np.eye(2)
    around = ellipse(covariance, 2.0, 16)
    inverse = np.linalg.inv(covariance)
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", around, inverse, around), 4, rtol=1e-6)
    np.testing.assert_allclose(around.mean(axis=0), 0, atol=1e-9)
