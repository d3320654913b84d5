"""What a missing optional package says: how to get it from where lidar-core came from."""

import json

import pytest
from repository import ROOT

import lidar_core.extras as extras
from lidar_core.errors import MissingExtraError


class Noted:
    """A distribution with pip's note of where it came from."""

    def __init__(self, note):
        self.note = note

    def read_text(self, name):
        assert name == "direct_url.json"
        return (
            self.note if self.note is None or isinstance(self.note, str) else json.dumps(self.note)
        )


@pytest.fixture
def comes_from(monkeypatch):
    def put(note):
        monkeypatch.setattr(extras, "_distribution", lambda: Noted(note))

    return put


def told():
    with pytest.raises(MissingExtraError) as refused:
        extras.require("no_such_package.part", extra="viz", purpose="a test")
    begin = "a test needs the package 'no_such_package': "
    assert str(refused.value).startswith(begin)
    return str(refused.value).removeprefix(begin)


@pytest.mark.parametrize("note", [None, "", "{}", "[]", "no JSON"])
def test_hint_of_a_missing_extra_names_the_index_without_a_note(comes_from, note):
    comes_from(note)
    assert told() == "pip install 'lidar-core[viz]'"


def test_hint_of_a_missing_extra_names_the_wheel_file(comes_from, tmp_path):
    wheel = tmp_path / "with space" / "lidar_core-1-py3-none-any.whl"
    wheel.parent.mkdir()
    wheel.touch()
    comes_from({"url": wheel.as_uri(), "archive_info": {}})
    assert told() == f"pip install '{wheel}[viz]'"
    wheel.unlink()
    assert told() == (
        f"pip install '{wheel.name}[viz]' (it was installed from {wheel}, which is gone)"
    )


@pytest.mark.parametrize(("editable", "option"), [(True, "-e "), (False, "")])
def test_hint_of_a_missing_extra_names_the_checkout(comes_from, tmp_path, editable, option):
    comes_from({"url": tmp_path.as_uri(), "dir_info": {"editable": editable}})
    assert told() == f"pip install {option}'{tmp_path}[viz]'"


def test_hint_of_a_missing_extra_names_the_repository(comes_from):
    comes_from({"url": "https://host/a.git", "vcs_info": {"vcs": "git", "commit_id": "abc"}})
    assert told() == "pip install 'lidar-core[viz] @ git+https://host/a.git@abc'"


def test_hint_of_a_missing_extra_names_the_address_of_a_wheel(comes_from):
    comes_from({"url": "https://host/lidar_core-1.whl", "archive_info": {}})
    assert told() == "pip install 'lidar-core[viz] @ https://host/lidar_core-1.whl'"


def test_hint_of_a_missing_extra_of_a_checkout_that_is_only_on_the_path(monkeypatch, tmp_path):
    def none():
        raise extras.PackageNotFoundError

    monkeypatch.setattr(extras, "_distribution", none)
    monkeypatch.setattr(extras, "__file__", str(tmp_path / "python" / "lidar_core" / "extras.py"))
    assert told() == "pip install 'lidar-core[viz]'"
    (tmp_path / "pyproject.toml").touch()
    assert told() == f"pip install '{tmp_path}[viz]'"


@pytest.mark.parametrize("editable", [True, False])
def test_training_is_installed_from_the_checkout(comes_from, tmp_path, editable):
    checkout = tmp_path / "with space"
    (checkout / "training").mkdir(parents=True)
    (checkout / "training/pyproject.toml").touch()
    comes_from({"url": checkout.as_uri(), "dir_info": {"editable": editable}})
    assert extras.install_command("train") == f"pip install '{checkout}/training'"


def test_training_without_a_checkout_says_where_it_is(comes_from, tmp_path):
    for note in (None, {"url": tmp_path.as_uri(), "dir_info": {}}, {"url": "https://a.org/b.whl"}):
        comes_from(note)
        told = "pip install . ./training (in a checkout of lidar_core)"
        assert extras.install_command("train") == told


def test_training_of_a_checkout_that_is_only_on_the_path_brings_the_package(monkeypatch):
    def missing():
        raise extras.PackageNotFoundError

    monkeypatch.setattr(extras, "_distribution", missing)
    monkeypatch.setattr(extras, "_checkout", lambda: ROOT)
    assert extras.install_command("train") == f"pip install {ROOT} {ROOT}/training"
