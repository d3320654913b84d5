"""`lidar-core evaluate`: from a simulated scene to scores, through the commands; every table."""

import json
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from commands import command_line, invoke, json_of
from flying_scenes import drone, yard
from hypothesis import given, settings
from hypothesis import strategies as st
from repository import ROOT

from lidar_core import FormatError, LidarCoreError, MissingExtraError, evaluation
from lidar_core.extras import install_command
from lidar_core.io import read_columns, write_mcap, write_tracks_table

PAGE = ROOT / "docs" / "evaluation.md"
SCANS, BURN_IN = 20, 10
result_of = partial(json_of, "evaluate")
FLIGHT = drone((6.0, 4.0, 3.5), (5.0, 6.0, 4.0))


def refusal_of(*arguments):
    out = invoke("evaluate", *arguments)
    assert isinstance(out.exception, LidarCoreError | OSError), out.output
    return out.exception


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Scene, recording, truth and run, all by commands."""
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "yard.toml").write_text(yard(FLIGHT, scans=SCANS).to_toml())
    recording = folder / "yard.npz"
    for arguments in (
        ("simulate", folder / "yard.toml", "-o", recording),
        ("detect", recording, "-o", folder / "run", "--no-picture", "--threads", 1),
    ):
        out = invoke(*arguments)
        assert out.exit_code == 0, out.output
    return folder


@pytest.fixture
def tracks(place):
    """Columns of the run's tracks."""
    return read_columns(place / "run" / "tracks.parquet")


def write_csv(path, columns):
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_from_a_scene_to_scores(place):
    out = invoke("evaluate", place / "run", place / "yard.truth.csv")
    assert out.exit_code == 0, out.output
    for name in ("recall of tracks", "along the line of sight", "GOSPA", "HOTA", "time per scan"):
        assert name in out.output
    assert f"after the first {BURN_IN} scans" in out.output.replace("\n", " ")
    values = result_of(place / "run", place / "yard.truth.csv")
    tracks, detections = values["track_scores"], values["detection_scores"]
    assert values["config"]["burn_in_scans"] == BURN_IN
    assert tracks["n_eligible"] == SCANS - BURN_IN
    assert tracks["recall"] == detections["recall"] == 1.0
    assert tracks["false_ids"] == []
    assert list(tracks["first_delay"].values()) == [0.0]
    assert set(tracks["over_distance"]) == {"recall@10m", "precision@10m", "error@10m"}
    assert tracks["velocity_error"]["mean"] < 2
    assert tracks["state_nees"]["degrees"] == 6
    assert values["identity_scores"]["mota"] == 1.0
    assert values["latency_ms"]["total"]["count"] == SCANS
    assert values["latency_ms"]["stages"]["track"]["mean"] > 0
    assert values["tracks_without_truth"] == 0


def test_a_part_is_scored_over_its_own_time(place, tmp_path):
    words = ("detect", place / "yard.npz", "-o", tmp_path / "part", "--no-picture")
    assert invoke(*words, "--start", 0.4, "--end", 1.5).exit_code == 0
    out = invoke("evaluate", tmp_path / "part", place / "yard.truth.csv")
    values = result_of(tmp_path / "part", place / "yard.truth.csv")
    scans = values["latency_ms"]["total"]["count"]
    left_out = values["truth_before_run"], values["truth_after_run"]
    assert scans < SCANS
    assert min(left_out) > 0
    assert sum(left_out) == SCANS - scans
    assert values["track_scores"]["n_eligible"] == max(scans - BURN_IN, 0)
    assert f"note: {left_out[0]} true positions before the first scan of the run and" in out.stdout
    assert f"{left_out[1]} after its last scan are left out" in out.stdout


def test_a_table_of_a_part_says_what_lies_outside_its_time(place):
    values = result_of(place / "run" / "tracks_tum", place / "yard.truth.csv", "--burn-in", 0)
    assert values["truth_outside_tracks"] >= BURN_IN
    assert values["truth_before_run"] == values["truth_after_run"] == 0
    out = invoke("evaluate", place / "run" / "tracks_tum", place / "yard.truth.csv", "--burn-in", 0)
    assert f"note: {values['truth_outside_tracks']} of {SCANS} true" in out.stdout


def test_the_recording_stands_for_the_truth_beside_it(place):
    again = result_of(place / "run", place / "yard.npz")
    expected = result_of(place / "run", place / "yard.truth.csv")
    assert again["track_scores"] == expected["track_scores"]


def test_options_change_what_counts(place):
    files = place / "run", place / "yard.truth.csv"
    assert result_of(*files, "--max-distance", 1)["track_scores"]["n_eligible"] == 0
    assert result_of(*files, "--min-hits", 10**6)["track_scores"]["recall"] is None
    assert result_of(*files, "--burn-in", 15)["track_scores"]["n_eligible"] == SCANS - 15
    tight = result_of(*files, "--gate", 0.001)["track_scores"]
    assert (tight["n_found"], tight["n_false"]) == (0, tight["n_estimates"])
    assigned = result_of(*files, "--set", "gate=0.001", "--no-identities")
    assert assigned["track_scores"] == tight
    assert assigned["identity_scores"] is None
    assert "gate" in str(refusal_of(*files, "--gate", 0))


@pytest.mark.parametrize("kind", ["csv", "npz", "tum", "file.txt", "mcap", "run.mcap"])
def test_tables_of_tracks(place, tracks, tmp_path, kind):
    names = ("t_ns", "track_id", "x", "y", "z")
    columns = {name: tracks[name] for name in names}
    if kind == "csv":
        path = write_csv(tmp_path / "tracks.csv", columns)
    elif kind == "npz":
        path = tmp_path / "tracks.npz"
        np.savez(path, **columns)
    elif kind == "tum":
        path = place / "run" / "tracks_tum"
    elif kind == "file.txt":
        path = place / "run" / "tracks_tum" / "track_0.txt"
    elif kind == "mcap":
        path = tmp_path / "tracks.mcap"
        write_mcap(path, states(tracks))
    else:
        path = place / "run" / "run.mcap"
    truth = place / "yard.truth.csv"
    values = result_of(path, truth, "--burn-in", BURN_IN)
    expected = result_of(place / "run", truth)["track_scores"]
    for name in ("recall", "n_found", "n_false", "n_switches"):
        assert values["track_scores"][name] == expected[name]
    # TUM holds micrometres.
    mean = values["track_scores"]["position_error"]["mean"]
    assert mean == pytest.approx(expected["position_error"]["mean"], abs=1e-5)
    assert values["track_scores"]["velocity_error"] is None
    assert values["detection_scores"] is None
    assert values["latency_ms"] is None


def states(columns):
    """Rows of a table as tracks, one time each."""
    from lidar_core.flying import Tracks

    for row in range(len(columns["t_ns"])):
        one = slice(row, row + 1)
        yield Tracks(
            id=columns["track_id"][one],
            position=np.stack([columns[name][one] for name in "xyz"], axis=1),
            velocity=np.zeros((1, 3)),
            acceleration=np.zeros((1, 3)),
            covariance=np.eye(9)[None],
            extent=np.ones((1, 3)),
            n_detections=np.ones(1, np.int64),
            age=np.ones(1),
            existence=np.ones(1),
            kind=np.ones(1, np.uint8),
            kind_probability=np.full((1, 5), 0.2),
            stamp_ns=int(columns["t_ns"][row]),
        )


def test_detections_keep_when_and_how_large_they_were(place):
    columns = read_columns(place / "run" / "detections.parquet")
    delay = columns["time_ns"] - columns["t_ns"]
    assert (delay >= 0).all()
    assert 0 < delay.max() < 10**8
    assert (columns["radius"] > 0).all()
    detections = evaluation.read_prediction(place / "run").detections
    np.testing.assert_array_equal(detections.time_ns, columns["time_ns"])
    truth = evaluation.read_truth(place / "yard.truth.csv")
    moved = evaluation.evaluate(truth, detections=detections).detections
    start = evaluation.evaluate(truth, detections=replace(detections, time_ns=None)).detections
    assert moved.mean_error < start.mean_error


def test_the_table_of_a_run_counts_as_its_run(place, tmp_path):
    """Its burn-in and its kinds are known; those of a copy elsewhere are not."""
    run = place / "run"
    whole, table = (
        evaluation.read_prediction(run),
        evaluation.read_prediction(run / "tracks.parquet"),
    )
    assert whole.burn_in_scans == table.burn_in_scans == 10
    np.testing.assert_array_equal(whole.tracks.position, table.tracks.position)
    copy = tmp_path / "tracks.parquet"
    copy.write_bytes((run / "tracks.parquet").read_bytes())
    assert evaluation.read_prediction(copy).burn_in_scans is None


def test_a_table_of_tracks_keeps_everything(tracks, tmp_path):
    path = write_tracks_table(tmp_path / "tracks.csv", states(tracks))
    prediction = evaluation.read_prediction(path)
    np.testing.assert_array_equal(prediction.tracks.covariance, np.tile(np.eye(6), (10, 1, 1)))
    np.testing.assert_array_equal(prediction.tracks.id, tracks["track_id"])
    again = write_tracks_table(tmp_path / "tracks.parquet", states(tracks))
    for name, column in read_columns(again).items():
        np.testing.assert_array_equal(column, read_columns(path)[name])


def test_tracks_can_stand_for_the_truth(place):
    values = result_of(place / "run", place / "run" / "tracks.parquet", "--burn-in", 0)
    scores = values["track_scores"]
    assert (scores["recall"], scores["position_error"]["largest"]) == (1.0, 0.0)
    assert scores["over_distance"] == {}
    assert scores["radial_error"] is None


def test_a_covariance_that_is_none_is_named(place, tracks, tmp_path):
    path = tmp_path / "tracks.npz"
    np.savez(
        path,
        **{name: column for name, column in tracks.items() if name not in ("frame_id", "kind")}
        | {"cov_x_x": -tracks["cov_x_x"]},
    )
    text = str(refusal_of(path, place / "yard.npz"))
    assert "tracks.npz, row 1: its covariance is not positive definite" in text


def test_of_a_track_written_twice_the_last_row_counts(tmp_path):
    columns = {"t_ns": np.zeros(2, np.int64), "track_id": np.full(2, 3)}
    columns |= {name: np.array([5.0, 7.0]) for name in "xyz"}
    table = evaluation.read_prediction(write_csv(tmp_path / "a.csv", columns)).tracks
    assert table.position.tolist() == [[7.0, 7.0, 7.0]]


def test_tracks_at_other_times_are_told_or_refused(place, tracks, tmp_path):
    columns = {name: tracks[name].copy() for name in ("t_ns", "track_id", "x", "y", "z")}
    columns["t_ns"][0] += 10**10
    truth = place / "yard.truth.csv"
    path = write_csv(tmp_path / "a.csv", columns)
    out = invoke("evaluate", path, truth)
    assert "note: 1 tracks lie at times without truth" in out.output.replace("\n", " ")
    columns["t_ns"] = tracks["t_ns"] + 10**15
    text = str(refusal_of(write_csv(tmp_path / "b.csv", columns), truth))
    assert "no time in common" in text
    assert str(truth) in text
    assert "time_tolerance" in text


def warnings_of(*arguments):
    values = result_of(*arguments)
    assert values["warnings"] is not None
    return values["warnings"]


def moved(tracks, tmp_path, **changes):
    """A table of the run's tracks, with some columns changed."""
    columns = {name: tracks[name].copy() for name in ("t_ns", "track_id", "x", "y", "z")}
    for name, change in changes.items():
        columns[name] = change(columns[name])
    return write_csv(tmp_path / "moved.csv", columns)


def test_a_good_pair_of_tracks_and_truth_is_without_warning(place, tracks, tmp_path):
    truth = place / "yard.truth.csv"
    assert warnings_of(place / "run", truth) == []
    assert warnings_of(moved(tracks, tmp_path), truth) == []
    assert "warning" not in invoke("evaluate", place / "run", truth).output


def test_tracks_that_overlap_the_truth_nowhere_in_time_are_told_with_both_spans(
    place, tracks, tmp_path
):
    truth = place / "yard.truth.csv"
    path = moved(tracks, tmp_path, t_ns=lambda t: t + 10**12)
    text = str(refusal_of(path, truth))
    first, last = tracks["t_ns"].min() * 1e-9 + 1000, tracks["t_ns"].max() * 1e-9 + 1000
    assert f"one ends before the other begins ({first:.3f} to {last:.3f} s and " in text
    assert "time_tolerance=SECONDS" in text
    config = evaluation.EvaluationConfig()
    report = evaluation.evaluate(
        evaluation.read_truth(truth), tracks=evaluation.read_prediction(path).tracks, config=config
    )
    assert len(report.warnings) == 1
    assert "tracks and truth have no time in common" in report.warnings[0]
    assert f"{first:.3f} to {last:.3f} s" in report.warnings[0]


def test_tracks_a_hundred_metres_beside_the_truth_are_told_with_the_distance(
    place, tracks, tmp_path
):
    path = moved(tracks, tmp_path, x=lambda x: x + 100)
    (text,) = warnings_of(path, place / "yard.truth.csv")
    assert "none of the tracks is within the gate of 1 m" in text
    away = float(re.search(r"([\d.]+) m are typical", text)[1])
    assert 95 < away < 105
    assert "--gate" in text
    out = invoke("evaluate", path, place / "yard.truth.csv").output
    assert "warning: none of the tracks is within the gate" in out
    wide = warnings_of(path, place / "yard.truth.csv", "--gate", 300)
    assert wide == []


def test_stamps_just_outside_the_tolerance_are_told_with_their_offset_and_the_option(
    place, tracks, tmp_path
):
    truth = place / "yard.truth.csv"
    path = moved(tracks, tmp_path, t_ns=lambda t: t + 300_000)  # 0.2 ms outside 0.1 ms
    text = str(refusal_of(path, truth))
    assert "no track is within 0.1 ms of a time of the truth, though their spans overlap" in text
    assert "typically 0.3 ms after the truth" in text
    (option,) = re.findall(r"--set (time_tolerance=\S+)", text)
    assert warnings_of(path, truth, "--set", option) == []
    half = moved(tracks, tmp_path, t_ns=lambda t: t - 300_000 * (np.arange(len(t)) % 2))
    (told,) = warnings_of(half, truth)
    rows = len(tracks["t_ns"])
    assert f"{rows // 2} of {rows} tracks are just outside the tolerance of 0.1 ms" in told
    assert "typically 0.3 ms before the truth" in told
    (option,) = re.findall(r"--set (time_tolerance=\S+)", told)
    assert warnings_of(half, truth, "--set", option) == []


def test_tracks_between_the_times_of_a_slower_truth_are_no_shifted_clock(place, tracks, tmp_path):
    path = moved(tracks, tmp_path, t_ns=lambda t: t + 40_000_000 * (np.arange(len(t)) % 2))
    assert warnings_of(path, place / "yard.truth.csv") == []


def test_circles_and_fused_targets_beside_the_truth_are_told(tmp_path):
    stamps = np.arange(20) * 100_000_000
    circles = {
        "t_ns": stamps,
        "track_id": np.zeros(20, int),
        "x": np.full(20, 3.0),
        "y": np.zeros(20),
        "radius": np.full(20, 0.3),
    }
    true = {**circles, "target_id": circles["track_id"]}
    for name, columns in (("circles", circles), ("fused", circles | {"z": np.zeros(20)})):
        truth = write_csv(tmp_path / f"{name}-truth.csv", true | columns)
        good = write_csv(tmp_path / f"{name}.csv", columns)
        assert warnings_of(good, truth) == []
        far = write_csv(tmp_path / f"{name}-far.csv", columns | {"y": np.full(20, 100.0)})
        assert "100 m are typical" in warnings_of(far, truth)[0]
        late = write_csv(tmp_path / f"{name}-late.csv", columns | {"t_ns": stamps + 300_000})
        assert warnings_of(late, truth) == []  # the truth is interpolated to these times
        other = write_csv(tmp_path / f"{name}-other.csv", columns | {"t_ns": stamps + 10**10})
        assert "10.000 to 11.900 s and 0.000 to 1.900 s" in str(refusal_of(other, truth))


def bad_files(folder):
    def text(name, content):
        path = folder / name
        path.write_text(content)
        return path

    header = "t_ns,track_id,x,y,z\n"
    np.savez(folder / "table.npz", t_ns=np.zeros((2, 2)))
    (folder / "empty").mkdir()
    (folder / "half").mkdir()
    text("half/run.toml", "")
    (folder / "broken").mkdir()
    text("broken/run.toml", "config = [")
    text("broken/tracks.csv", header)
    return [
        (folder / "missing.csv", FileNotFoundError, "missing.csv: no such file or folder"),
        (text("a.xyz", ""), FormatError, "a.xyz: expected a table: .csv"),
        (text("a.csv", ""), FormatError, "a.csv: expected a first line with the names"),
        (text("b.csv", "t_ns,x\n1,2\n"), FormatError, "b.csv: no column y"),
        (text("c.csv", header + "1,2,3\n"), FormatError, "c.csv, row 1: expected 5 values"),
        (text("d.csv", header + "0.5,2,3,4,5\n"), FormatError, "column t_ns: expected integers"),
        (text("e.csv", header + "1,2,3,nan,5\n"), FormatError, "column y: expected finite numbers"),
        (text("f.csv", header + "1,2,3,far,5\n"), FormatError, "column y: expected numbers"),
        (text("g.parquet", "PAR1"), FormatError, "g.parquet: cannot be read"),
        (text("h.npz", "PK"), FormatError, "h.npz: cannot be read"),
        (folder / "table.npz", FormatError, "t_ns: expected one dimension"),
        (text("i.mcap", "x"), FormatError, "i.mcap"),
        (folder / "empty", FormatError, "empty: expected a run folder"),
        (folder / "half", FormatError, "half: the run folder holds no table of tracks"),
        (folder / "broken", FormatError, "run.toml: cannot be read"),
    ]


def test_what_cannot_be_read_is_named(place, tmp_path):
    for path, kind, words in bad_files(tmp_path):
        error = refusal_of(path, place / "yard.truth.csv")
        assert isinstance(error, kind), (path, error)
        assert words in str(error)


@pytest.fixture(scope="module")
def whole_files(place):
    """Bytes of a good file of every format."""
    run = place / "run"
    columns = read_columns(run / "tracks.parquet")
    np.savez(place / "tracks.npz", **{name: columns[name] for name in ("t_ns", "track_id", *"xyz")})
    write_csv(place / "tracks.csv", columns)
    paths = (
        place / "tracks.csv",
        place / "tracks.npz",
        run / "tracks.parquet",
        run / "run.mcap",
        run / "tracks_tum" / "track_0.txt",
    )
    return {path.suffix: path.read_bytes() for path in paths}


@pytest.mark.nightly
@given(
    suffix=st.sampled_from([".csv", ".npz", ".parquet", ".mcap", ".txt"]),
    at=st.floats(0, 1),
    junk=st.binary(max_size=20),
    keeps_tail=st.booleans(),
)
@settings(max_examples=150)
def test_damaged_files_are_read_or_refused_in_words(whole_files, suffix, at, junk, keeps_tail):
    content = whole_files[suffix]
    cut = int(at * len(content))
    rest = content[cut + len(junk) :] if keeps_tail else b""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"damaged{suffix}"
        path.write_bytes(content[:cut] + junk + rest)
        refusal = None
        try:
            evaluation.read_prediction(path)
        except LidarCoreError as error:
            refusal = str(error)
        assert refusal is None or str(path) in refusal


def test_truth_that_cannot_be_used_is_named(place, tmp_path):
    assert "holds no truth" in str(refusal_of(place / "run", place / "run"))
    twice = tmp_path / "twice.csv"
    twice.write_text("t_ns,target_id,x,y,z\n1,2,0,0,0\n1,2,0,0,0\n")
    error = refusal_of(place / "run", twice)
    assert isinstance(error, FormatError)
    assert "twice.csv: truth.id: expected one row per object and time, got 2 twice" in str(error)


def test_a_missing_extra_is_named(place, monkeypatch):
    from lidar_core import extras

    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", refuse)
    error = refusal_of(place / "run" / "tracks_tum", place / "yard.truth.csv", "--identities")
    assert isinstance(error, MissingExtraError)
    assert install_command("eval") in str(error)


def test_a_table_without_rows_is_a_run_that_found_nothing(place, tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("t_ns,track_id,x,y,z\n")
    scores = result_of(path, place / "yard.truth.csv")["track_scores"]
    assert (scores["recall"], scores["precision"], scores["n_false"]) == (0.0, None, 0)


def test_no_mcap_entity_without_a_number(tmp_path):
    import foxglove
    from foxglove import channels, messages

    context = foxglove.Context()
    path = tmp_path / "other.mcap"
    with foxglove.open_mcap(path, context=context):
        entity = messages.SceneEntity(id="house", timestamp=messages.Timestamp(sec=1, nsec=0))
        channel = channels.SceneUpdateChannel("/scene", context=context)
        channel.log(messages.SceneUpdate(entities=[entity]), log_time=1)
    with pytest.raises(FormatError, match="entity 'house': expected a track ID"):
        read_columns(path)


@pytest.mark.nightly  # the test of the guide runs the same page, and looks at its files alone
def test_the_commands_of_the_guide_run(tmp_path):
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    for line in block.strip().splitlines():
        name, *arguments = shlex.split(line)
        assert name == "lidar-core"
        done = subprocess.run(
            command_line(*arguments),
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["track_scores"]["false_ids"] == []
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-"],
        input="\n".join(code),
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def test_errors_of_the_program_are_one_line(tmp_path):
    done = subprocess.run(
        command_line("evaluate", "none", "truth.csv"),
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 2
    assert done.stderr == "error: none: no such file or folder\n"
