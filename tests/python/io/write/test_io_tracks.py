"""Track tables, trajectories and scenes hold what was tracked."""

import csv
import re
from dataclasses import dataclass

import numpy as np
import pyarrow.parquet as parquet
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import lidar_core as lc
import lidar_core.io
from lidar_core.extras import install_command
from lidar_core.io.tables import tracks as module

BASE_NS = 1_700_000_000_000_000_001


@dataclass
class Tracks:
    """Tracks at one time, as the tracker returns them."""

    id: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
    extent: np.ndarray
    n_detections: np.ndarray
    age: np.ndarray
    existence: np.ndarray
    kind: np.ndarray
    kind_probability: np.ndarray
    stamp_ns: int


def make_tracks(numbers, stamp_ns):
    rng = np.random.default_rng(sum(numbers))
    count = len(numbers)
    root = rng.normal(size=(count, 9, 9))
    return Tracks(
        id=np.array(numbers, np.int64),
        position=rng.normal(size=(count, 3)) * 10,
        velocity=rng.normal(size=(count, 3)),
        covariance=root @ root.transpose(0, 2, 1),
        extent=rng.random((count, 3)),
        n_detections=np.arange(count, dtype=np.int64) + 3,
        age=rng.random(count),
        existence=rng.random(count),
        kind=np.arange(count, dtype=np.uint8) + 1,
        kind_probability=rng.dirichlet(np.ones(5), size=count),
        stamp_ns=stamp_ns,
    )


@pytest.fixture
def tracks():
    steps = [([4, 9], 0), ([], 1), ([9], 2)]
    return [make_tracks(numbers, BASE_NS + k * 10**8) for numbers, k in steps]


def check_rows(rows, tracks):
    assert [(int(row["t_ns"]), int(row["track_id"])) for row in rows] == [
        (BASE_NS, 4),
        (BASE_NS, 9),
        (BASE_NS + 2 * 10**8, 9),
    ]
    for row, (state, k) in zip(rows, [(tracks[0], 0), (tracks[0], 1), (tracks[2], 0)], strict=True):
        assert row["frame_id"] == "map"
        got = [float(row[name]) for name in ("x", "y", "z", "vx", "vy", "vz")]
        assert got == [*state.position[k], *state.velocity[k]]
        assert float(row["cov_x_x"]) == state.covariance[k, 0, 0]
        assert float(row["cov_y_vz"]) == state.covariance[k, 1, 5]
        assert float(row["extent_z"]) == state.extent[k, 2]
        assert int(row["n_detections"]) == state.n_detections[k]
        assert float(row["existence"]) == state.existence[k]
        assert row["kind"] == ("flying", "ground")[k]
        shares = [float(row[f"p_{one.name.lower()}"]) for one in lc.TrackKind]
        assert shares == state.kind_probability[k].tolist()


def test_parquet_table(tmp_path, tracks):
    path = lc.io.write_tracks_table(tmp_path / "tracks.parquet", iter(tracks), frame_id="map")
    assert path == tmp_path / "tracks.parquet"
    check_rows(parquet.read_table(path).to_pylist(), tracks)


@pytest.mark.parametrize("name", ["tracks.csv", "tracks.parquet"])
def test_csv_table_on_request_or_without_pyarrow(tmp_path, tracks, monkeypatch, name):
    monkeypatch.setattr("lidar_core.io.tables.long_table.find_spec", lambda _: None)
    path = lc.io.write_tracks_table(tmp_path / name, tracks, frame_id="map")
    assert path == tmp_path / "tracks.csv"
    with path.open(newline="") as file:
        check_rows(list(csv.DictReader(file)), tracks)


def test_no_tracks_give_a_table_without_rows(tmp_path):
    for name in ("tracks.parquet", "tracks.csv"):
        assert lc.io.write_tracks_table(tmp_path / name, []).exists()
    table = parquet.read_table(tmp_path / "tracks.parquet")
    assert (table.num_rows, table.column_names) == (0, list(module.COLUMNS))


def test_tum_trajectories(tmp_path, tracks):
    paths = lc.io.write_tum(tmp_path / "tum", tracks)
    assert [path.name for path in paths] == ["track_4.txt", "track_9.txt"]
    lines = paths[1].read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["1700000000.000000001", "1700000000.200000001"]
    values = np.loadtxt(paths[1])
    np.testing.assert_allclose(values[1, 1:4], tracks[2].position[0], atol=1e-6)
    np.testing.assert_array_equal(values[:, 4:], [[0, 0, 0, 1]] * 2)
    assert lc.io.open_recording  # a trajectory is a poses file, too:
    from lidar_core.io.poses.pose_files import read_poses

    stamps, _ = read_poses(paths[1])
    assert stamps.tolist() == [BASE_NS, BASE_NS + 2 * 10**8]


def test_tracks_in_mcap_are_scene_entities(tmp_path, tracks):
    lc.io.write_mcap(tmp_path / "a.mcap", tracks, tracks_frame="map")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        updates = [item.decoded_message for item in reader.iter_decoded_messages()]
    assert [[entity.id for entity in update.entities] for update in updates] == [
        ["4", "9"],
        [],
        ["9"],
    ]
    entity = updates[0].entities[1]
    assert entity.frame_id == "map"
    position = entity.cubes[0].pose.position
    np.testing.assert_array_equal([position.x, position.y, position.z], tracks[0].position[1])
    assert entity.cubes[0].pose.orientation.w == 1
    assert entity.texts[0].text.startswith("9: ")
    with lc.io.open_recording(tmp_path / "a.mcap") as recording:
        assert list(recording) == []
        assert recording.skipped == {"/tracks": 3}


def test_nested_poses_are_always_filled(tmp_path):
    scan = lc.messages.Scan(0, np.zeros((1, 3), np.float32))
    pose = lc.messages.Pose(0, "map", "lidar", np.eye(4))
    lc.io.write_mcap(tmp_path / "a.mcap", [pose, scan])
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = {
            item.channel.topic: item.decoded_message for item in reader.iter_decoded_messages()
        }
    cloud, transform = messages["/lidar/points"], messages["/tf"]
    assert cloud.HasField("pose")
    assert cloud.pose.HasField("position")
    assert cloud.pose.orientation.w == 1
    assert transform.HasField("translation")
    assert transform.rotation.w == 1


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    from lidar_core import extras

    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", refuse)
    with pytest.raises(lc.MissingExtraError, match=re.escape(install_command("viz"))):
        lc.io.write_mcap(tmp_path / "a.mcap", [])
    (tmp_path / "b.mcap").write_bytes(b"x")
    with pytest.raises(lc.MissingExtraError, match=re.escape(install_command("io"))):
        lc.io.open_recording(tmp_path / "b.mcap", trusted=True)
