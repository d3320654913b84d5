"""A panic in the core is an InternalError, wherever it happens; the object retires."""

import pytest

from lidar_core import InternalError, VoxelMap, _core


@pytest.mark.parametrize("place", ["detached", "stoppable", "pool"])
def test_a_panic_in_a_function_is_an_error(place):
    planted = _core.PlantedPanic()
    with pytest.raises(InternalError):
        planted.fall(place)
    assert planted.stand() == 1  # the object had no part in it


@pytest.mark.parametrize("place", ["with", "with_stoppable"])
def test_an_object_that_panicked_refuses_further_calls_and_others_work(place):
    planted, other = _core.PlantedPanic(), _core.PlantedPanic()
    assert planted.stand() == 1
    with pytest.raises(InternalError, match="met a bug"):
        planted.fall(place)
    for call in (planted.stand, lambda: planted.fall(place)):
        with pytest.raises(InternalError, match="refuses further calls"):
            call()
    assert other.stand() == 1
    assert VoxelMap().n_observed == 0
