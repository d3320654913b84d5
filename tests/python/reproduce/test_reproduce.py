"""`lidar-core reproduce`: the framework, and every item in short."""

import json
import tomllib
from functools import partial
from importlib import import_module
from typing import NamedTuple

import numpy as np
import pytest
from commands import invoke
from matplotlib.image import imread

from lidar_core import ConfigError, reproduce, sim
from lidar_core.reproduce import COLUMNS, Item, Measured, Request, Row
from lidar_core.reproduce.jobs import Job, run
from lidar_core.reproduce.registry import MODULES, declared, item_named, items


class Short(NamedTuple):
    """A short run of an item, and the rows that have numbers for its modes in it."""

    rows: tuple[str, ...]
    scans: int = 16
    seed: int = 7
    range_max: float = 12.0
    modes: tuple[str, ...] = ("paper_mode", "best_mode")


SHORT = {
    "circles-detectors": Short(
        ("all, cnn: MSE", "all, ml: p99", "all, triangle: MAE", "cnn: time per object"),
        modes=("best_mode",),
    ),
    "circles-table1": Short(("parameters", "multiply-adds per object")),
    "circles-table2": Short(("circles", "train", "validation", "test", "all")),
    "circles-fig5": Short(("loss of the shipped weights, validation",)),
    "circles-table3": Short(("test: MSE", "train + validation: MAE")),
    "flying-fig3": Short(
        ("scans taken for occupied, log-odds", "time until free again, G(v)"), scans=70
    ),
    "flying-fig4": Short(
        ("time to first detection", "share with a detection, without removal"), scans=36
    ),
    "flying-fig5": Short(("0.01 m, 0.1 deg, 0.01 m, linearised@1m",)),
    "flying-detection-probability": Short(
        ("predicted, os0-128, whole sphere@5m", "simulated, os0-128, whole sphere@5m")
    ),
    "flying-table3": Short(
        ("sphere, detections: mean error", "any sphere, tracks: recall"), range_max=20.0
    ),
    "flying-fig7": Short(
        ("error of detections@16.25m", "recall of tracks@1m/s", "error of detections@1m/s2"),
        range_max=20.0,
    ),
    "flying-fig8": Short(
        ("all flights, detections: mean error", "following, tracks: recall"),
        scans=45,
        range_max=20.0,
    ),
    "flying-crossings": Short(("recall of tracks", "mean least distance at a scan"), scans=1),
    "flying-occlusions": Short(("share of ids kept", "recall of tracks"), scans=1, range_max=20.0),
    "flying-pose-noise": Short(
        ("false tracks per 1000 scans", "recall of detections", "share of sightings with a track")
    ),
    "flying-consistency": Short(("own model: mean NEES / 9", "circles: position error@1m/s^2")),
    "flying-range": Short(
        ("recall of detections, sphere, d_max 50 m", "recall of tracks, sphere, d_max 50 m"),
        seed=1002,
        range_max=36.0,
    ),
    "flying-false-tracks": Short(
        (
            "false tracks, ideal",
            "false tracks per 1000 scans, dust",
            "false tracks per 1000 scans, thick dust",
            "false tracks per 1000 scans, swarm",
            "false tracks per 1000 scans, sparse leaves",
        )
    ),
    "flying-real": Short(
        ("street_128_labelled/recall", "rs16_office/false_tracks", "livox_horizon_sway/scans"),
        modes=("best_mode",),
    ),
    "flying-drivers": Short(
        ("vlp-16/recall", "livox-avia/false_tracks", "xt32/target scans"), modes=("best_mode",)
    ),
    "flying-situations": Short(
        ("fixed wing 2.2 m: recall, goal >= 0.98", "goals met"), modes=("best_mode",)
    ),
    "tracking-takeover": Short(
        ("stood, another 1 m away, alone: number taken over, goal <= .05",), modes=("best_mode",)
    ),
    "flying-surfaces": Short(
        ("fog/sky known@4m", "wet/surfaces cleared", "glass/false_tracks", "all/target scans"),
        modes=("best_mode",),
        range_max=60.0,
    ),
    "circles-table4": Short(("r = 0.6 m: radius, MSE", "ghosts")),
    "circles-table5": Short(("5 wandering: x, MSE", "ghosts")),
    "circles-fig7": Short(("trajectory 2: y, MSE",)),
    "circles-fig8": Short(("room, swinging: ghosts", "25-75 % hidden: radius, RMS")),
    "circles-lab": Short(("barrel: radius, RMS", "person is one element")),
    "circles-shapes": Short(("right", "circle: right"), modes=("best_mode",), scans=40),
    "circles-real": Short(
        (
            "parallel/vehicle, velocity rms",
            "aces/jumps per minute",
            "example1/numbers that moved 1 m, per person",
        ),
        modes=("best_mode",),
    ),
    "circles-situations": Short(
        (
            "noise as told/NEES (3)",
            "people on two legs/velocity, rms",
            "square and elliptic posts/centre, rms",
            "cluttered room/existence, calibration error",
        ),
        modes=("best_mode",),
    ),
    "fusion-rmse": Short(("2-D RMSE, linear KF", "2-D RMSE, EKF-CTRV"), scans=1),
    "fusion-fig4": Short(("walking: RMSE of z", "driving: 3-D RMSE"), scans=1),
    "fusion-fig7": Short(("RMSE of x, filter", "RMSE of y, filter"), scans=1),
    "fusion-fig8": Short(("2-D RMSE in the figure, filter",), scans=1),
    "fusion-fig9": Short(("2-D RMSE, label 16 dB, filter",), scans=1),
    "fusion-fig10": Short(("linear KF@-30dBW", "EKF-CTRV@5dBW"), scans=1),
    "fusion-fig11": Short(("linear KF@0dBW",), scans=1),
    "fusion-drone-yaw": Short(("RMSE of x@1rad/s", "2-D RMSE over that at rest@1rad/s"), scans=1),
    "fusion-consistency": Short(
        ("ctrv, ekf: steps inside the band",), modes=("best_mode",), scans=10
    ),
    "fusion-real": Short(
        (
            "obj_pose/2-D RMSE over that, noise told x 1/3",
            "autoferry 2/one-to-one share, lesser target",
            "autoferry 17/GOSPA, empty output",
            "autoferry/mean MOTA",
            "delphi esr/NIS per value",
        ),
        modes=("best_mode",),
    ),
    "tracking-noise": Short(
        ("ctrv: RMSE, noise told x 0.2", "ctrv: NEES / 2, noise told right"),
        modes=("best_mode",),
        scans=4,
    ),
    "tracking-dropout": Short(("10 m/s, turns back: first fix",), modes=("best_mode",), scans=4),
    "tracking-existence": Short(
        ("default, all: calibration error", "default, all: Brier over base rate"),
        modes=("best_mode",),
        scans=1,
    ),
    "tracking-clutter": Short(
        ("integrated, clutter 10: OSPA", "nearest, clutter 10: false tracks per scan"),
        modes=("best_mode",),
        scans=1,
    ),
    "tracking-scaling": Short(
        ("pairs compared per target and scan, 1000 targets",), modes=("best_mode",), scans=2
    ),
}


@pytest.fixture
def coarse_sensor(request, monkeypatch):
    """Every sensor has fewer rays and sees less far: the items stay what they are, in seconds."""
    range_max = SHORT[request.getfixturevalue("name")].range_max
    preset = sim.LidarModel.preset.__func__

    def coarse(cls, name, **changes):
        full = preset(cls, name, **changes)
        if not isinstance(full.pattern, sim.Spinning):
            return full
        pattern = sim.Spinning(elevations_deg=full.pattern.elevations_deg[::2], columns=512)
        return full.model_copy(update={"pattern": pattern, "range_max": range_max})

    monkeypatch.setattr(sim.LidarModel, "preset", classmethod(coarse))


@pytest.fixture
def its_recordings(request, monkeypatch):
    """Items find the recordings that they need."""
    if items()[request.getfixturevalue("name")].data:
        monkeypatch.setenv("LIDAR_CORE_DATA", str(request.getfixturevalue("recordings")))


run_command = partial(invoke, "reproduce")


def item(name, measure, **more):
    return Item(
        name=name,
        title=f"{name} in short",
        scans=10,
        minutes=1,
        measure=measure,
        rows=lambda *rows: rows,
        draw=lambda figure, *rows: figure.subplots().plot([0, 1]),
        **more,
    )


def counted(request: Request) -> Measured:
    request.advance(request.scans)
    return Measured((Row("recall@10m", "1", None, 0.5, np.float64(request.seed)),), request.scans)


def stopped(request: Request) -> Measured:
    raise KeyboardInterrupt


@pytest.fixture
def two_items(monkeypatch):
    """Two items in place of those that there are; returns a way to change them."""

    def put(*chosen):
        known = {one.name: one for one in chosen}
        monkeypatch.setattr(reproduce, "items", lambda: known)
        monkeypatch.setattr(reproduce, "item_named", known.__getitem__)

    put(item("first", counted), item("second", counted))
    return put


# Every item


NIGHTLY = {
    "flying-false-tracks",
    "flying-real",
    "flying-situations",
    "circles-real",
    "circles-table4",
    "circles-table5",
    "circles-fig8",
}
"""Items that take minutes even in short; tables 4 and 5 and figure 8 run as figure 7 does, and
false tracks as `flying-drivers` does."""


@pytest.mark.ci_cases("flying-crossings", "fusion-fig10")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly) if name in NIGHTLY else name
        for name in items()
    ],
)
@pytest.mark.usefixtures("coarse_sensor", "its_recordings")
def test_an_item_in_short_gives_a_table_a_picture_and_json(name, tmp_path):
    result = tmp_path / "result.json"
    short = SHORT[name]
    out = run_command(
        name,
        "--scans",
        short.scans,
        "--seed",
        short.seed,
        "--threads",
        1,
        "-o",
        tmp_path,
        "--json",
        result,
    )
    assert out.exit_code == 0, out.output
    values = json.loads(result.read_text())
    assert set(values) == {"item", "seed", "command", "rows"}
    assert (values["item"], values["seed"]) == (name, short.seed)
    assert values["rows"]
    for row in values["rows"]:
        assert list(row) == ["name", "unit", *COLUMNS]
        numbers = [row[column] for column in COLUMNS]
        assert all(value is None or np.isfinite(value) for value in numbers), row
        assert row["name"]
        assert row["unit"]
    rows = {row["name"]: row for row in values["rows"]}
    assert len(rows) == len(values["rows"])
    for wanted in short.rows:
        assert None not in (rows[wanted][mode] for mode in short.modes), rows[wanted]
    assert json.loads((tmp_path / f"{name}.json").read_text()) == values
    note = tomllib.loads((tmp_path / f"{name}.toml").read_text())
    assert note["input"]["item"] == name
    assert imread(tmp_path / f"{name}.png").shape[0] > 300


def test_items_are_named_once_and_after_the_paper_of_their_folder():
    modules = {name: import_module(f"lidar_core.reproduce.{name}") for name in MODULES}
    named = [(name, one.name) for name, module in modules.items() for one in declared(module)]
    assert {name for name, _ in named} == set(MODULES)
    assert [name for _, name in named] == list(items())
    assert all(module.partition(".")[0] == name.partition("-")[0] for module, name in named)
    for one in items().values():
        assert one.title
        assert one.minutes <= 60


# The command


@pytest.mark.parametrize("columns", [60, 80])
def test_without_an_item_the_list_names_all_of_them_also_on_a_narrow_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    out = run_command()
    assert out.exit_code == 0
    for name in items():
        assert name in out.output


def test_long_runs_are_told_in_hours():
    one = item("first", counted)  # a minute for ten
    assert [one.duration(scans) for scans in (1, 10, 15, 1190, 4000)] == [
        "6 s",
        "60 s",
        "2 min",
        "119 min",
        "6.7 h",
    ]


def test_an_unknown_item_is_named_with_the_known_ones(tmp_path):
    out = run_command("flying-fig44", "-o", tmp_path / "a")
    assert isinstance(out.exception, ConfigError)
    assert "flying-fig4" in str(out.exception).split(", got ")[0]
    assert "'flying-fig44'" in str(out.exception)
    assert not (tmp_path / "a").exists()
    with pytest.raises(ConfigError, match="expected one of"):
        item_named("all")


@pytest.mark.usefixtures("two_items")
def test_all_writes_a_list_and_says_beforehand_how_long_it_takes(tmp_path):
    out = run_command("all", "-o", tmp_path, "--scans", 5, "--json", "-")
    assert out.exit_code == 0
    values = json.loads(out.stdout)
    assert [one["item"] for one in values] == ["first", "second"]
    assert values[0]["rows"] == [
        {
            "name": "recall@10m",
            "unit": "1",
            "paper": None,
            "paper_mode": 0.5,
            "equations_corrected": None,
            "best_mode": 0.0,
        }
    ]
    assert "first: 5 scans, about 30 s on two cores" in out.stderr
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{kind}" for name in ("first", "second") for kind in ("json", "png", "toml")
    }


def test_the_column_of_corrected_equations_is_shown_where_an_item_has_it(two_items, tmp_path):
    def corrected(request: Request) -> Measured:
        return Measured((Row("error", "m", 0.163, 1.25, 0.124, 0.162),), request.scans)

    two_items(item("first", counted), item("second", corrected))
    without, having = (
        run_command(name, "-o", tmp_path / name, "--no-picture").output
        for name in ("first", "second")
    )
    assert "paper mode" in without
    assert "equations" not in without
    assert having.index("paper mode") < having.index("equations") < having.index("best mode")
    assert all(value in having for value in ("0.163", "1.250", "0.162", "0.124"))
    (row,) = json.loads((tmp_path / "second" / "second.json").read_text())["rows"]
    assert list(row) == ["name", "unit", *COLUMNS]
    assert [row[column] for column in COLUMNS] == [0.163, 1.25, 0.162, 0.124]


def test_all_leaves_out_what_has_no_recordings_and_says_so(tmp_path, two_items, monkeypatch):
    monkeypatch.delenv("LIDAR_CORE_DATA", raising=False)
    two_items(item("first", counted), item("second", counted, data=("fusion/a.txt",)))
    out = run_command("all", "-o", tmp_path, "--json", "-")
    assert out.exit_code == 0
    assert [one["item"] for one in json.loads(out.stdout)] == ["first"]
    assert "left out, LIDAR_CORE_DATA does not hold their recordings: second" in out.stderr


def test_stopped_with_ctrl_c_the_files_of_what_was_finished_are_whole(tmp_path, two_items):
    two_items(item("first", counted), item("second", stopped))
    out = run_command("all", "-o", tmp_path / "a", "--json", tmp_path / "result.json")
    assert out.exit_code == 130
    assert [one["item"] for one in json.loads((tmp_path / "result.json").read_text())] == ["first"]
    assert {path.name for path in (tmp_path / "a").iterdir()} == {
        "first.json",
        "first.png",
        "first.toml",
    }


# Parts of long runs


class Enough(Exception):  # noqa: N818
    """The jobs of an item are known."""


WITHOUT_JOBS = {"circles-fig5", "circles-fig7", "circles-table1", "circles-table2"}
WITHOUT_JOBS |= {"flying-fig3", "flying-fig5", "flying-consistency"}
WITHOUT_JOBS |= {name for name in items() if name.startswith(("fusion-", "tracking-"))}
WITHOUT_JOBS |= {"circles-real"}  # recordings alone: no seed


@pytest.mark.parametrize("name", sorted(set(items()) - WITHOUT_JOBS))
@pytest.mark.usefixtures("its_recordings")
def test_the_parts_of_another_seed_have_other_names(name, monkeypatch, tmp_path):
    def noted(jobs, request):
        names.append({job.name for job in jobs})
        raise Enough

    monkeypatch.setattr("lidar_core.reproduce.jobs._in_processes", noted)
    names: list[set[str]] = []
    one = items()[name]
    for seed in (0, 1):
        with pytest.raises(Enough):
            one.run(Request(seed=seed, scans=one.scans, threads=2, parts=tmp_path))
    assert all(len(found) > 1 for found in names)
    assert not names[0] & names[1]


def doubled(*, number, log):
    with open(log, "a", encoding="utf-8") as file:
        file.write(f"{number}\n")
    return {"value": np.array([2 * number])}


def jobs_for(log, numbers=range(3)):
    arguments = [{"number": number, "log": str(log)} for number in numbers]
    return [Job(f"part-{values['number']}", doubled, values, 5) for values in arguments]


def made(log):
    return sorted(map(int, log.read_text().split()))


@pytest.mark.parametrize("threads", [1, 2])
def test_parts_come_in_the_order_of_the_jobs_and_are_made_once(tmp_path, threads):
    log, advanced = tmp_path / "log", []
    request = Request(
        seed=0, scans=15, threads=threads, parts=tmp_path / "parts", advance=advanced.append
    )
    for _ in range(2):
        parts = run(jobs_for(log), request)
        assert [part["value"].tolist() for part in parts] == [[0], [2], [4]]
        assert all(set(part) == {"value"} for part in parts)
    assert made(log) == [0, 1, 2]
    assert sum(advanced) == 30


def test_a_part_of_other_arguments_or_cut_short_is_made_again(tmp_path):
    log, folder = tmp_path / "log", tmp_path / "parts"
    request = Request(seed=0, scans=15, threads=1, parts=folder)
    run(jobs_for(log), request)
    other = [Job("part-0", doubled, {"number": 9, "log": str(log)}, 5)]
    assert run(other, request)[0]["value"].tolist() == [18]
    whole = (folder / "part-1.npz").read_bytes()
    (folder / "part-1.npz").write_bytes(whole[: len(whole) // 2])
    (folder / "part-2.npz").write_text("not ours")
    run(jobs_for(log, (1, 2)), request)
    assert made(log) == [0, 1, 1, 2, 2, 9]


@pytest.mark.nightly
def test_a_part_with_a_flipped_byte_is_never_taken_for_another(tmp_path):
    log, folder = tmp_path / "log", tmp_path / "parts"
    request = Request(seed=0, scans=5, threads=1, parts=folder)
    run(jobs_for(log, [1]), request)
    path = folder / "part-1.npz"
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        part = run(jobs_for(log, [1]), request)[0]
        assert part["value"].tolist() == [2], place
        assert set(part) == {"value"}, place
    assert len(made(log)) > len(whole) / 2


def test_without_a_folder_no_part_is_kept(tmp_path):
    log = tmp_path / "log"
    for _ in range(2):
        run(jobs_for(log, [1]), Request(seed=0, scans=5, threads=1))
    assert made(log) == [1, 1]


def test_fresh_makes_the_parts_of_the_item_again_and_leaves_all_others(tmp_path, two_items):
    log = tmp_path / "log"

    def with_parts(request):
        run(jobs_for(log, [1]), request)
        return counted(request)

    two_items(item("first", with_parts))
    folder = tmp_path / "a" / "parts"
    folder.mkdir(parents=True)
    np.savez(folder / "mine.npz", kept=np.arange(3))
    foreign = (folder / "mine.npz").read_bytes()
    run(jobs_for(log, [2]), Request(seed=0, scans=5, threads=1, parts=folder))
    for more in ([], [], ["--fresh"]):
        out = run_command("first", "-o", tmp_path / "a", "--no-picture", *more)
        assert out.exit_code == 0, out.output
    run(jobs_for(log, [2]), Request(seed=0, scans=5, threads=1, parts=folder))
    assert made(log) == [1, 1, 2]
    assert (folder / "mine.npz").read_bytes() == foreign
    assert not (tmp_path / "a" / "first.png").exists()
