"""Maps cleaned of what moved: oracle, definitions of the benchmark, files, command."""

import numpy as np
import pytest
from commands import invoke, json_of
from pypcd4 import Encoding, PointCloud

from lidar_core import FormatError, InputError
from lidar_core.evaluation import read_labelled_cloud, score_static_map
from lidar_core.io import write_cloud


def by_hand(points, truth, moved, same=0.05):
    """SA, DA and AA from the table of all distances."""
    kept = (np.linalg.norm(truth[:, None] - points, axis=2) <= same).any(axis=1)
    static, dynamic = 100 * kept[~moved].mean(), 100 * (~kept[moved]).mean()
    return static, dynamic, np.sqrt(static * dynamic)


@pytest.mark.parametrize("seed", range(5))
def test_shares_are_those_of_all_distances(seed):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-0.5, 0.5, (400, 3)) + rng.normal(0, 100, 3)
    points = truth[rng.random(400) < 0.4] + rng.normal(0, 0.03, 3)
    moved = rng.random(400) < 0.3
    scores = score_static_map(points, truth, moved)
    found = scores.static_accuracy, scores.dynamic_accuracy, scores.associated_accuracy
    np.testing.assert_allclose(found, by_hand(points, truth, moved), rtol=1e-12)
    assert 0 < scores.static_accuracy < 100
    assert 0 < scores.dynamic_accuracy < 100


def test_voxels_hold_what_is_in_them():
    rng = np.random.default_rng(3)
    centers = np.unique(rng.integers(-4, 4, (60, 3)), axis=0) * 0.25 + 0.125
    truth = rng.uniform(-1.2, 1.2, (500, 3))
    away = np.abs(truth[:, None] - centers).max(axis=2)
    kept = (away <= 0.125 + 0.05).any(axis=1)
    scores = score_static_map(centers, truth, np.zeros(500, bool), resolution=0.25)
    assert scores.n_kept == kept.sum()
    assert scores.dynamic_accuracy is None
    assert scores.associated_accuracy is None


def test_an_empty_map_has_removed_everything():
    scores = score_static_map(np.empty((0, 3)), [[0, 0, 0], [1, 0, 0]], [True, False])
    assert (scores.static_accuracy, scores.dynamic_accuracy) == (0, 100)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([[0, 0, 0]], [[0, 0, np.nan]], [False]), "truth_points"),
        (([[0, 0, 0]], [[0, 0, 0]], [False, True]), "is_dynamic"),
        (([[1e9, 0, 0]], [[0, 0, 0]], [False]), "within"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arguments, text):
    with pytest.raises(InputError, match=text):
        score_static_map(*arguments)


def labelled(path, points, label):
    values = np.column_stack([points, label]).astype(np.float32)
    PointCloud.from_xyzi_points(values).save(path, encoding=Encoding.BINARY)


def test_the_command_reads_the_folder_of_the_benchmark(tmp_path):
    wall = np.column_stack([np.full(50, 3.0), np.linspace(0, 4.9, 50), np.ones(50)])
    passer = wall - [1.0, 0.0, 0.0]
    labelled(tmp_path / "gt_cloud.pcd", np.concatenate([wall, passer]), [0] * 50 + [1] * 50)
    write_cloud(tmp_path / "mine_output.pcd", np.concatenate([wall[:40], passer[:5]]))
    result = json_of("evaluate", tmp_path / "mine_output.pcd", "--static", tmp_path)
    assert result["static_accuracy"] == 80
    assert result["dynamic_accuracy"] == 90
    assert result["associated_accuracy"] == pytest.approx(np.sqrt(7200))
    shown = invoke("evaluate", tmp_path / "mine_output.pcd", "--static", tmp_path)
    assert shown.exit_code == 0
    assert "80.00 %" in shown.output
    assert "AA" in shown.output


def test_what_is_no_labelled_cloud_is_refused(tmp_path):
    write_cloud(tmp_path / "bare.pcd", [[0.0, 0.0, 1.0]])
    with pytest.raises(FormatError, match="intensity"):
        read_labelled_cloud(tmp_path / "bare.pcd")
    labelled(tmp_path / "odd.pcd", np.ones((2, 3)), [0, 7])
    with pytest.raises(FormatError, match="other numbers"):
        read_labelled_cloud(tmp_path / "odd.pcd")
    both = invoke("evaluate", tmp_path / "bare.pcd", tmp_path, "--static", tmp_path)
    assert "cannot be combined with TRUTH" in str(both.exception)
    assert "--static" in str(invoke("evaluate", tmp_path / "bare.pcd").exception)
