"""`lidar-core events`: what happened in runs, found again by queries that never run as code."""

import json

import numpy as np
import pytest
from commands import invoke
from hypothesis import given
from hypothesis import strategies as st

from lidar_core.batch import JobRecord
from lidar_core.errors import ConfigError, FormatError
from lidar_core.evaluation import read_prediction
from lidar_core.io import read_columns
from lidar_core.runs.catalogue import (
    EVENTS,
    OBJECTS,
    absent_texts,
    columns_named,
    events_of,
    matching_rows,
    objects_of,
)
from lidar_core.runs.catalogue.query import MOST_LETTERS, read_table


def made(*arguments):
    done = invoke(*arguments)
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    few = ("--sensor", "os1-32", "--scans", 30)
    made("simulate", "demo", "-o", folder / "street.npz", *few)
    made("detect", folder / "street.npz", "-o", folder / "flying", "--no-picture", "--no-mcap")
    made("simulate", "circles", "-o", folder / "a.npz", "--scans", 20)
    made("circles", folder / "a.npz", "-o", folder / "circles", "--no-picture")
    made("simulate", "overflight", "-o", folder / "b.csv", "--scans", 50)
    made("fuse", folder / "b.csv", "-o", folder / "fusion", "--no-picture")
    return folder


def tracks_by_hand(folder):
    """Rows of each track, by a loop over the table."""
    table = read_columns(next(folder.glob("tracks.*")))
    found = {}
    for row, number in enumerate(table["track_id"].tolist()):
        found.setdefault(number, []).append(row)
    return table, found


def test_every_track_has_its_first_sight_and_its_closest_approach(runs):
    folder = runs / "flying"
    table, rows = tracks_by_hand(folder)
    timing = read_columns(next(folder.glob("timing.*")))
    sensor = {
        stamp: np.array([timing[f"sensor_{axis}"][row] for axis in "xyz"])
        for row, stamp in enumerate(timing["t_ns"].tolist())
    }
    assert len({tuple(place) for place in sensor.values()}) > 1  # it moves
    events = events_of(folder)
    assert list(events) == list(EVENTS)
    assert len(rows) == 2
    for row, number in enumerate(events["track_id"].tolist()):
        (same,) = np.flatnonzero(
            (table["track_id"] == number) & (table["t_ns"] == events["t_ns"][row])
        )
        assert events["kind_then"][row] == table["kind"][same]
        assert events["kind"][row] == table["kind"][rows[number][-1]]
    for number, mine in rows.items():
        places = np.stack([table[axis][mine] for axis in "xyz"], axis=1)
        stamps = [int(table["t_ns"][row]) for row in mine]
        away = [
            np.linalg.norm(place - sensor[stamp])
            for place, stamp in zip(places, stamps, strict=True)
        ]
        of = {
            events["event"][row]: row
            for row in range(len(events["event"]))
            if events["track_id"][row] == number
        }
        assert events["t_ns"][of["first_sight"]] == stamps[0]
        nearest = of["closest_approach"]
        assert events["distance"][nearest] == pytest.approx(min(away))
        assert events["t_ns"][nearest] == stamps[int(np.argmin(away))]
        assert events["rows"][nearest] == len(mine)
        assert "lost" not in of  # both are in sight at the end


def test_a_track_that_ends_before_the_run_is_lost(runs, tmp_path):
    """The same run with the last scans of one track taken out."""
    source = runs / "flying"
    for name in ("run.toml", next(source.glob("timing.*")).name):
        (tmp_path / name).write_bytes((source / name).read_bytes())
    table, rows = tracks_by_hand(source)
    cut = rows[min(rows)][-5:]
    kept = [row for row in range(len(table["t_ns"])) if row not in cut]
    lines = [",".join(table)]
    lines += [",".join(str(values[row]) for values in table.values()) for row in kept]
    (tmp_path / "tracks.csv").write_text("\n".join(lines) + "\n")
    events = events_of(tmp_path)
    lost = matching_rows(events, "event == 'lost'")
    assert lost["track_id"].tolist() == [min(rows)]
    assert lost["t_ns"].tolist() == [int(table["t_ns"][rows[min(rows)][-6]])]


@pytest.mark.parametrize("kind", ["flying", "circles", "fusion"])
def test_objects_of_all_commands_have_the_same_columns(runs, kind):
    objects = objects_of(runs / kind, recording="a", run="b")
    assert list(objects) == list(OBJECTS)
    assert {len(values) for values in objects.values()} == {len(objects["t_ns"])}
    assert set(objects["recording"].tolist()) == {"a"}
    assert (objects["time"] >= 0).all()
    speed = np.hypot(objects["vx"], objects["vy"])
    assert (objects["speed"] >= speed - 1e-12).all()
    known = np.isfinite(objects["distance"])
    assert known.all() if kind != "fusion" else not known.any()  # its sensor moves
    if kind == "circles":
        assert (objects["extent_x"] > 0).all()


def two_targets(path, *, at_x=None):
    """Detections of two objects that stand at x = 30 and 60 m, and poses where `at_x` is given."""
    lines = ["t_ns,x,y,pose_x,pose_y,pose_yaw"]
    for number in range(60):
        stamp = number * 10**8
        if at_x is not None:
            lines.append(f"{stamp},,,{at_x(number)},0.0,0.0")
        ahead = 0.0 if at_x is None else at_x(number)
        jitter = 0.01 * (-1) ** number
        lines += [f"{stamp},{place - ahead + jitter},{jitter},,," for place in (30.0, 60.0)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("moves", [False, True])
def test_many_targets_have_their_distances_from_the_sensor(tmp_path, moves):
    file = two_targets(tmp_path / "a.csv", at_x=(lambda number: 0.2 * number) if moves else None)
    made("fuse", file, "-o", tmp_path / "run", "--association", "integrated", "--no-picture")
    objects = objects_of(tmp_path / "run")
    assert len(set(objects["track_id"].tolist())) == 2
    assert (objects["kind"] != "").all()
    ahead = 2.0 * objects["t_ns"] * 1e-9 if moves else np.zeros(len(objects["t_ns"]))
    by_hand = np.hypot(objects["x"] - ahead, objects["y"])
    np.testing.assert_allclose(objects["distance"], by_hand, atol=1e-6)
    events = events_of(tmp_path / "run")
    nearest = matching_rows(events, "event == 'closest_approach' and distance < 35")
    assert len(nearest["track_id"]) == 1
    assert nearest["distance"][0] == pytest.approx(18.2 if moves else 30.0, abs=0.5)


def test_a_run_of_many_targets_without_places_of_its_sensor_has_unknown_distances(tmp_path):
    (tmp_path / "run.toml").write_text("")
    (tmp_path / "tracks.csv").write_text("t_ns,track_id,x,y,z,vx,vy,vz\n1,0,3.0,4.0,0,0,0,0\n")
    (tmp_path / "states.csv").write_text("t_ns,track_id,x,y\n1,0,3.0,4.0\n")
    assert np.isnan(objects_of(tmp_path)["distance"]).all()
    assert events_of(tmp_path)["event"].tolist() == ["first_sight"]


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(FormatError, match="expected the folder of a run, with tracks or circles"):
        objects_of(tmp_path)
    with pytest.raises(FormatError, match="expected a table, the folder of a run or of a batch"):
        read_table(tmp_path)


def test_a_folder_of_tables_is_one_table(runs, tmp_path):
    """Such as tracks/ of a batch. Tables of a run, or of several recordings, are not the same."""
    header = "recording,t_ns,track_id,x,y,z"
    (tmp_path / "b.csv").write_text(f"{header}\nstreet,3,1,0,0,0\n")
    (tmp_path / "a.csv").write_text(f"{header}\nyard,1,1,0,0,0\nyard,2,1,0,0,0\n")
    table = read_columns(tmp_path)
    assert table["t_ns"].tolist() == [1, 2, 3]
    assert table["recording"].tolist() == ["yard", "yard", "street"]
    assert read_table(tmp_path)["t_ns"].tolist() == [1, 2, 3]
    with pytest.raises(FormatError, match="tracks of 2 recordings; give the table of one"):
        read_prediction(tmp_path)
    (tmp_path / "b.csv").write_text(f"{header}\nyard,3,1,0,0,0\n")  # of another run
    with pytest.raises(FormatError, match=r"2 tables, such as a\.csv; give one"):
        read_prediction(tmp_path)
    (tmp_path / "d.csv").mkdir()  # is no table
    (tmp_path / "c.csv").write_text("t_ns\n1\n")
    with pytest.raises(FormatError, match=r"c\.csv: expected the columns of a\.csv"):
        read_columns(tmp_path)
    with pytest.raises(FormatError, match=r"several tables; give one of .*tracks\.(csv|parquet)"):
        read_columns(runs / "flying")


def test_an_event_has_the_kind_of_its_track_where_it_ends(tmp_path):
    """What moves is static at first sight: nothing of it has moved yet."""
    (tmp_path / "run.toml").write_text("")
    lines = ["t_ns,track_id,kind,x,y,radius"]
    for scan, kind in enumerate(["unknown", "static", "ground", "ground"]):
        lines += [f"{scan},1,{kind},{scan},0,0.3", f"{scan},2,static,5,0,0.1"]
    (tmp_path / "circles.csv").write_text("\n".join(lines) + "\n")
    moved = matching_rows(events_of(tmp_path), "kind == 'ground' and event == 'first_sight'")
    assert moved["track_id"].tolist() == [1]
    assert moved["kind_then"].tolist() == ["unknown"]
    still = matching_rows(events_of(tmp_path), "kind == 'static' and event == 'first_sight'")
    assert still["track_id"].tolist() == [2]
    assert objects_of(tmp_path)["kind"].tolist()[::2] == ["unknown", "static", "ground", "ground"]


def test_a_batch_that_was_killed_is_told_with_its_cure(tmp_path):
    for number, status in enumerate(["done", "running", "failed", "running"]):
        folder = tmp_path / f"job-{number}"
        folder.mkdir()
        JobRecord(folder.name, "job", "key", status).write(folder)
    text = r"interrupted, or still runs: 1 of 4 jobs are done.*same `lidar-core batch` command"
    with pytest.raises(FormatError, match=text):
        read_table(tmp_path)
    (tmp_path / "events.csv").write_text("event,distance\nlost,2.0\n")
    assert read_table(tmp_path)["event"].tolist() == ["lost"]


TABLE = {
    "distance": np.array([5.0, 25.0, np.nan, 12.0]),
    "track_id": np.array([1, 2, 3, 4]),
    "event": np.array(["lost", "first_sight", "lost", "closest_approach"]),
}


@pytest.mark.parametrize(
    ("query", "rows"),
    [
        ("distance < 20", [1, 4]),
        ("not distance < 20", [2, 3]),
        ("distance < 20 and event == 'lost'", [1]),
        ("distance < 10 or track_id >= 4", [1, 4]),
        ("event in ('lost', 'first_sight')", [1, 2, 3]),
        ("event not in ['lost']", [2, 4]),
        ("10 < distance <= 12", [4]),
        ("-distance + 2 * track_id / 2 > -5", [1]),
        ("True == True", [1, 2, 3, 4]),
        ("distance < 20 and (event == 'lost' or track_id == 4)", [1, 4]),
    ],
)
def test_queries_choose_rows(query, rows):
    assert matching_rows(TABLE, query)["track_id"].tolist() == rows


def test_columns_of_results_have_dots():
    table = {"detect.tracks.flying": np.array([0, 2]), "value.file": np.array(["a", "b"])}
    assert matching_rows(table, "detect.tracks.flying > 1")["value.file"].tolist() == ["b"]
    assert matching_rows(table, "value.file == 'a'")["detect.tracks.flying"].tolist() == [0]
    assert columns_named("detect.tracks.flying > 1") == {"detect.tracks.flying"}
    assert absent_texts(table, "value.file == 'c'") == [("value.file", "c", ["a", "b"])]
    with pytest.raises(ConfigError, match=r"did you mean detect\.tracks\.flying"):
        matching_rows(table, "detect.track.flying > 1")


ODD = {
    "circles-1.elements": np.array([3, 8]),
    "ms per scan": np.array([1.0, 2.0]),
    "class": np.array(["a", "b"]),
    "_0": np.array([5, 6]),
    "": np.array([0, 1]),
}


@pytest.mark.parametrize(
    ("query", "rows"),
    [
        ("`circles-1.elements` > 4", [1]),
        ("`circles-1`.elements > 4", [1]),
        ("0 < `circles-1.elements` - 2 * `ms per scan` <= 1", [0]),
        ("`class` == 'a' or `class` in ('`b`', \"it's `a`\")", [0]),
        ("`_0` == 6 and _0 > `circles-1.elements`-3", [1]),
        ("`` == 1", [1]),
        ("not `class` == 'a\\'`b`'", [0, 1]),
    ],
)
def test_columns_of_any_name_stand_between_backticks(query, rows):
    found = matching_rows(ODD, query)
    assert found["_0"].tolist() == ODD["_0"][rows].tolist()
    assert columns_named(query) <= ODD.keys()


@pytest.mark.parametrize(
    ("query", "text"),
    [
        (
            "circles-1.elements > 4",
            r"; a column of this name needs backticks: `circles-1\.elements`$",
        ),
        ("ms per scan > 4", "a column of this name needs backticks: `ms per scan`$"),
        (
            "`circles-2.elements` > 4",
            r"got 'circles-2\.elements'; did you mean circles-1\.elements",
        ),
        ("`circles-1.elements > 4", "needs backticks: `circles-1.elements`$"),
        ("`ms per scan > 4 and _0 > 3", "needs backticks: `ms per scan`$"),
        ("_0 > 'ms per scan'", "compares a text with a number$"),
        ("_0 < 4 `", "cannot read"),
        ("subclass == 3", "expected one of .*, got 'subclass'"),
        ("`class` in (`class`, 'a')", "expected numbers or texts in a list, got a column$"),
        ("`class` = 'a'", "use == to compare: `class` == 'a'"),
        ("`class` == a", "no column a; texts need quotes: `class` == 'a'"),
        ("`class` < 3", "query: '`class` < 3' compares a text with a number"),
        ("`ms per scan`.real() > 3", r"cannot use '`ms per scan\.real`\(\)'"),
        ("f().`ms per scan` > 3", r"cannot use 'f\(\)\.ms per scan'"),
        ("f(`ms per scan`=`class`) > 3", r"cannot use 'f\(ms per scan=`class`\)'"),
        ("distance is (" + "-" * 900 + "1)", "cannot |expected one of"),  # as deep as the stack is
    ],
)
def test_names_between_backticks_are_told_as_they_are_written(query, text):
    with pytest.raises(ConfigError, match=text):
        matching_rows(ODD, query)


def test_texts_of_a_column_between_backticks_that_no_row_has_are_found():
    assert absent_texts(ODD, "`class` == 'c'") == [("class", "c", ["a", "b"])]


def test_the_command_takes_names_between_backticks(tmp_path):
    (tmp_path / "a.csv").write_text("circles-1.elements,b\n3,1\n8,2\n")
    done = invoke("events", "`circles-1.elements` > 4", tmp_path / "a.csv", "--json", "-")
    assert json.loads(done.stdout) == [{"circles-1.elements": 8, "b": 2}]


@pytest.mark.parametrize(
    ("query", "text"),
    [
        ("distanc < 3", "did you mean distance"),
        ("distance <", "cannot read"),
        ("distance", "expected a comparison"),
        ("distance and event", "expected comparisons between"),
        ("__import__('os').system('true')", "cannot use"),
        ("distance.__class__ == 3", r"got 'distance\.__class__'"),
        ("(1).real == 1", "cannot use"),
        ("'a'.upper() == 'A'", "cannot use"),
        ("[one for one in distance] == 3", "cannot use"),
        ("distance ** 2 > 3", "cannot use"),
        ("distance is None", "cannot use"),
        ("event < 3", "compares a text with a number"),
        ("(" * 300 + "distance" + ")" * 300 + " < 1", "cannot read"),
        ("not " * 60 + "distance < 1", "nested deeper"),
        ("distance < 1 " * MOST_LETTERS, f"expected {MOST_LETTERS} letters at most"),
        ("", "cannot read"),
        ("event == lost", r"no column lost; texts need quotes: event == 'lost'"),
        ("lost != event and distance < 3", r"texts need quotes: 'lost' != event"),
        ("event in (lost, 'first_sight')", r"quotes: event in \('lost', 'first_sight'\)"),
        ("distance == lost", "expected one of distance, track_id, event"),
        ("event = 'lost'", "use == to compare: event == 'lost'"),
        ("distance<=3 and event='a=b'", "use == to compare: distance<=3 and event=='a=b'"),
        ("event = ", "cannot read"),
    ],
)
def test_what_is_no_query_is_refused_in_words(query, text):
    with pytest.raises(ConfigError, match=text):
        matching_rows(TABLE, query)


@given(st.text("distance<>=()`'\"andornt_i 0123.-+*/[]{}:@\\\n", max_size=60))
def test_any_text_is_a_query_or_an_error(query):
    try:
        found = matching_rows(TABLE, query)
    except ConfigError:
        return
    assert len(found["track_id"]) <= 4


def test_the_command_prints_and_writes_rows(runs, tmp_path):
    done = invoke("events", "distance < 20", runs / "flying", "--json", "-")
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)
    assert {row["event"] for row in rows} <= {"first_sight", "closest_approach"}
    assert all(row["distance"] < 20 for row in rows)
    assert rows
    made("events", "all", runs / "fusion", "-o", tmp_path / "a.csv", "--json", tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text())[0]["distance"] is None
    table = read_table(tmp_path / "a.csv")
    assert list(table) == list(EVENTS)
    again = invoke("events", "all", tmp_path / "a.csv", "-o", tmp_path / "a.csv")
    assert isinstance(again.exception, FileExistsError)
    made("events", "time >= 0", tmp_path / "a.csv", "-o", tmp_path / "a.csv", "--overwrite")
    refused = invoke("events", "all", tmp_path / "a.csv", "-o", tmp_path / "a.txt")
    assert "expected a file that ends in .csv or .parquet" in str(refused.exception)
    nowhere = invoke("events", "all", tmp_path / "a.csv", "-o", tmp_path / "no" / "b.csv")
    assert isinstance(nowhere.exception, FileNotFoundError)
    assert nowhere.output == ""  # refused before anything is printed


def test_a_column_that_no_row_knows_is_named(runs, tmp_path):
    """A query of it finds nothing, which says nothing about what happened."""
    (tmp_path / "a.csv").write_text("event,distance,speed\nlost,nan,1.0\nlost,nan,2.0\n")
    found = invoke("events", "distance < 20", tmp_path / "a.csv")
    assert found.exit_code == 0, found.output
    assert "note: distance: unknown in all rows" in found.stderr
    other = invoke("events", "speed < 1.5", tmp_path / "a.csv")
    assert "unknown" not in other.stderr
    known = invoke("events", "distance < 20", runs / "flying")
    assert "unknown" not in known.stderr


def test_texts_that_no_row_has_are_named_with_those_that_occur(tmp_path):
    (tmp_path / "a.csv").write_text("event,kind,distance\nlost,,1\nfirst_sight,ground,2\n")
    wrong = invoke("events", "kind in ('grund', 'ground')", tmp_path / "a.csv")
    assert wrong.exit_code == 0, wrong.output
    assert "1 of 2 rows" in wrong.output
    assert "note: kind: no row has 'grund'; the values are ground" in wrong.stderr
    for query in ("kind == 'ground'", "kind != '' and distance < 2", "event < 'm'", "all"):
        right = invoke("events", query, tmp_path / "a.csv")
        assert right.exit_code == 0, right.output
        assert "no row has" not in right.stderr
    found = absent_texts(read_table(tmp_path / "a.csv"), "'lots' == event or distance < 3")
    assert found == [("event", "lots", ["first_sight", "lost"])]


@pytest.mark.parametrize(("rows", "is_told"), [(40, False), (41, True)])
def test_a_list_that_is_cut_says_how_to_get_the_rest(tmp_path, rows, is_told):
    (tmp_path / "a.csv").write_text("event\n" + "lost\n" * rows)
    shown = invoke("events", "all", tmp_path / "a.csv")
    assert ("the first 40 are shown (-o FILE.csv: all)" in shown.output) == is_told


def test_the_columns_of_the_query_are_shown(tmp_path):
    names = [f"job.number_{number}" for number in range(20)]
    (tmp_path / "a.csv").write_text(",".join(names) + "\n" + ",".join(map(str, range(20))) + "\n")
    header = invoke("events", "job.number_19 > 1", tmp_path / "a.csv").output.split("\n")[0]
    assert header.split() == [*names[:11], "job.number_19"]


def test_words_inside_a_text_are_no_columns(tmp_path):
    """Only what the query asks for is told to be unknown."""
    (tmp_path / "a.csv").write_text("event,distance\nlost distance,nan\nlost,nan\n")
    inside = invoke("events", "event == 'lost distance'", tmp_path / "a.csv")
    assert inside.exit_code == 0, inside.output
    assert "1 of 2 rows" in inside.output
    assert "unknown" not in inside.stderr
    both = invoke("events", "event == 'speed' or distance < 20", tmp_path / "a.csv")
    assert "note: distance: unknown in all rows" in both.stderr
    assert columns_named("event in ('speed', \"x\") and not -distance < 2") == {"event", "distance"}
    with pytest.raises(ConfigError, match="cannot read"):
        columns_named("distance <")


WIDE = [
    *("detect.points", "detect.scans_moving", "detect.tracks", "detect.scans.received"),
    *(f"detect.ms_per_scan.stage_{number}" for number in range(60)),
    *("evaluate.track_scores.recall", "evaluate.detection_scores.recall"),
]
"""Columns as those of a batch."""


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("detect.moving_scans", "detect.scans_moving"),
        ("detect.track", "detect.tracks"),
        ("evaluate.tracks.recall", "evaluate.track_scores.recall"),
        ("Detect.Points", "detect.points"),
        ("scans_received", "detect.scans.received"),
    ],
)
def test_a_wrong_name_is_told_the_nearest_columns_of_many(wrong, right):
    """By their words, in any order: not only by their letters, and never all columns."""
    table = {name: np.zeros(1) for name in WIDE}
    with pytest.raises(ConfigError) as refused:
        matching_rows(table, f"{wrong} > 0")
    text = str(refused.value)
    assert text.startswith(f"query: column: expected one of {right}, ")
    assert text.endswith(f", got {wrong!r}; did you mean {right}?")
    assert f"and {len(WIDE) - 10} others (`lidar-core events all TABLE` lists them)" in text
    assert len(text) < 500


def test_a_name_that_is_like_none_has_no_suggestion():
    table = {name: np.zeros(1) for name in WIDE}
    with pytest.raises(ConfigError, match=r"got 'zzz'$"):
        matching_rows(table, "zzz > 0")
    with pytest.raises(ConfigError, match=r"expected one of none, got 'a'$"):
        matching_rows({}, "a > 0")


def test_the_columns_of_a_wide_table_are_listed_on_demand_alone(tmp_path):
    path = tmp_path / "results.csv"
    path.write_text(",".join(WIDE) + "\n" + ",".join("1" for _ in WIDE) + "\n")
    footer = invoke("events", "detect.tracks > 0", path).stdout.splitlines()[-1]
    assert footer.startswith("1 of 1 rows; columns: detect.points, ")
    assert footer.endswith(
        f"and {len(WIDE) - 11} others (`lidar-core events all TABLE` lists them)"
    )
    assert invoke("events", "all", path).stdout.endswith(f"columns: {', '.join(WIDE)}\n")
