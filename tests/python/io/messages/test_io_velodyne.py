"""Packets of Velodyne: the settings that go to the decoder."""

from enum import Enum
from types import SimpleNamespace

import pytest

from lidar_core import ConfigError
from lidar_core.io import ReadOptions
from lidar_core.io.messages.velodyne import decoder_config


def library():
    """What is used of velodyne-decoder, which need not be installed."""

    def config(**values):
        return SimpleNamespace(model=None, **values)

    return SimpleNamespace(Config=config, Model=Enum("Model", ["VLP16", "HDL32E"]))


def test_the_stated_model_goes_to_the_decoder():
    found = library()
    assert decoder_config(found, ReadOptions()).model is None
    options = ReadOptions(velodyne_model="HDL32E")
    assert decoder_config(found, options).model is found.Model.HDL32E


def test_a_model_that_the_decoder_does_not_know_is_told_with_those_it_knows():
    with pytest.raises(ConfigError, match="velodyne_model: expected one of VLP16, HDL32E, got"):
        decoder_config(library(), ReadOptions(velodyne_model="VLP-16"))
