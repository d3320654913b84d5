"""Points of the class MOVING against labelled boxes."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from lidar_core import PointClass
from lidar_core.errors import FormatError
from lidar_core.messages import PosedScan, Scan
from lidar_core.reproduce.flying.real_data import labelled_boxes as module
from lidar_core.reproduce.flying.real_data.labelled_boxes import (
    Box,
    MovingCounts,
    moving_scores,
    read_boxes,
    speeds,
)

MOVING, BACKGROUND = PointClass.MOVING, PointClass.BACKGROUND


def box(name, x, y, *, yaw=0.0, size=(4.0, 2.0, 1.5)):
    kind, _, number = name.partition(" ")
    return Box((kind, number), np.array([x, y, 0.0]), np.array(size), yaw)


def test_points_in_turned_boxes_are_found():
    rng = np.random.default_rng(0)
    points = rng.uniform(-4, 4, (500, 3))
    turned = box("Car 1", 0.5, -0.3, yaw=0.7)
    corners = [0.5 + 2 * np.cos(0.7), -0.3 + 2 * np.sin(0.7), 0.0]  # the middle of its front
    assert turned.holds(np.array([corners]) * 0.99, 0.05)[0]
    slow = []
    for x, y, z in points:
        # Turn the point back around the middle of the box.
        away = complex(x - 0.5, y + 0.3) * np.exp(-0.7j)
        slow.append(abs(away.real) <= 2.1 and abs(away.imag) <= 1.1 and abs(z) <= 0.85)
    assert turned.holds(points, 0.1).tolist() == slow
    assert 5 < sum(slow) < 50


def test_speeds_are_those_in_the_world():
    poses = []
    for number in range(7):
        pose = np.eye(4)
        pose[0, 3] = number  # the sensor goes on by 1 m per scan
        poses.append(pose)
    boxes = [
        [box("Car 1", 10 - number, 0), box("Truck 2", 10, 0), box("Car 3", 5, 5)]
        for number in range(7)
    ]
    boxes[5:] = [[one for one in of_scan if one.name[1] != "3"] for of_scan in boxes[5:]]
    found = speeds(boxes, poses, [0.1 * number for number in range(7)])
    assert found.keys() == {("Car", "1"), ("Truck", "2")}  # the third was seen for too short a time
    assert found["Car", "1"] == pytest.approx(0.0)
    assert found["Truck", "2"] == pytest.approx(10.0)


def counted(boxes, speed, classes, *, is_open=True):
    counts = MovingCounts([boxes], speed)
    item = PosedScan(Scan(0, np.float32(POINTS)), np.eye(4))
    status = SimpleNamespace(gate_open=is_open)
    counts.add(0, item, SimpleNamespace(status=status, point_class=np.repeat(np.uint8(classes), 8)))
    return counts.columns()


BOXES = [box("Car 1", 10, 0), box("Truck 2", -10, 0), box("Pedestrian 3", 0, 8, size=(1, 1, 2))]
SPEED = {("Car", "1"): 5.0, ("Truck", "2"): 0.1, ("Pedestrian", "3"): 1.4}
PLACES = [[10, 0, 0], [11, 0, 0], [-10, 0, 0], [0, 8, 0], [0, -9, 0]]
POINTS = np.repeat(PLACES, 8, axis=0)
"""Eight points at each place: two on the car, one on the truck and on the person, one elsewhere."""


def test_all_that_moves_and_nothing_else_is_a_full_score():
    part = counted(BOXES, SPEED, [MOVING, MOVING, BACKGROUND, MOVING, BACKGROUND])
    assert [value for _, _, value in moving_scores(part)] == [1.0, 1.0, 1.0]


def test_what_stands_and_moves_lowers_the_precision():
    part = counted(BOXES, SPEED, [MOVING, MOVING, MOVING, BACKGROUND, MOVING])
    assert [value for _, _, value in moving_scores(part)] == [0.5, 1.0, 0.0]


def test_what_moves_and_is_not_found_lowers_the_recall():
    part = counted(BOXES, SPEED, [BACKGROUND, MOVING, BACKGROUND, MOVING, BACKGROUND])
    assert [value for _, _, value in moving_scores(part)][:2] == [1.0, 0.5]


def test_an_object_of_unknown_speed_is_neither_right_nor_wrong():
    unknown = {name: speed for name, speed in SPEED.items() if name[0] != "Truck"}
    for speed in (unknown, SPEED | {("Truck", "2"): 0.6}):
        part = counted(BOXES, speed, [MOVING, MOVING, MOVING, MOVING, BACKGROUND])
        assert part["moving"].tolist() == [[24, 0, 1, 1, 1, 1]]
    known = counted(BOXES, SPEED, [MOVING, MOVING, MOVING, MOVING, BACKGROUND])
    assert known["moving"].tolist() == [[24, 8, 1, 1, 1, 1]]


def test_nothing_is_counted_before_the_gate_opens_or_without_labels():
    closed = counted(BOXES, SPEED, [MOVING] * 5, is_open=False)
    assert closed["moving"].shape == (0, 6)
    assert moving_scores(closed)[0][2] is None
    assert moving_scores({}) == []


def test_a_damaged_label_file_is_refused_with_its_name(monkeypatch, tmp_path):
    path = tmp_path / "000000.json"
    monkeypatch.setattr(module, "recording", lambda name: tmp_path)
    monkeypatch.setattr(module, "unpack_files", lambda path, suffix: [tmp_path / "000000.json"])
    entry = {"obj_id": "1", "obj_type": "Car", "psr": {}}
    for text in ("{", "[1]", json.dumps([entry]), '{"a": 1}'):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"000000\.json: expected a list of labelled boxes"):
            read_boxes(SimpleNamespace(labels="labels.tar.xz"))
