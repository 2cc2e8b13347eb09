"""On real frames: poses of others are judged by the depth image, told the object's mask: right ones pass, wrong ones do not."""

import os
from pathlib import Path

import numpy as np
import pytest

from handsight import se3
from handsight.vision import locate
from testbed import real_frames

NAMED = os.environ.get("HANDSIGHT_DATA")
DATA = (Path(NAMED) if NAMED else Path(__file__).parents[3] / "shared" / "data") / "ycbv_frames"
if not DATA.is_dir():
    pytest.skip("the real frames are not here: set HANDSIGHT_DATA to their folder", allow_module_level=True)
pytest.importorskip("PIL.Image", reason="PNG files come with handsight[robot]")


@pytest.mark.parametrize("most", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_given_poses_that_are_right_are_called_so_and_wrong_ones_are_not(most):
    """A few millimetres and degrees off; 3 cm, 6 cm and 120° off, and where a neighbour is."""
    frames, rng, rows = real_frames.open_folder(DATA), np.random.default_rng(0), []
    for read in frames.some(most):
        frame = read()
        for one in frame.instances:
            model, T = frames.models[one.name], one.T_camera_object
            about = se3.compose(np.eye(3), model.center_object)
            u, w = rng.normal(size=(2, 3)) / np.sqrt(3)
            neighbour = next(each for each in frame.instances if each is not one)
            starts = [T, se3.moved(T @ about, np.r_[0.003 * u, np.deg2rad(3) * w]) @ se3.inverse(about)]
            starts += [se3.moved(T, np.r_[far * u / np.linalg.norm(u), 0, 0, 0]) for far in (0.03, 0.06)]
            turn = se3.compose(se3.rotation_exp(np.deg2rad(120) * w / np.linalg.norm(w)), np.zeros(3))
            starts += [T @ about @ turn @ se3.inverse(about), neighbour.T_camera_object]
            mask = frame.wanted(one, "mask")
            judged = locate(
                model, np.nan_to_num(frame.depth), frame.camera, start=np.array(starts), mask=mask
            ).starts
            wrong = [real_frames.add_s(model, T, start) > 0.1 for start in starts]
            rows.append((judged.right[0], judged.right[1], (judged.right & wrong).sum()))
    truth, near, claimed = np.array(rows, float).T
    assert len(rows) >= 10
    assert truth.mean() > 0.8
    assert near.mean() > 0.7
    assert claimed.sum() == 0


def test_what_is_so_far_away_that_depth_tells_no_shape_is_not_claimed():
    """Tenths of millimetres that are taken for millimetres: noise and bounds grow with the square of the distance."""
    frames = real_frames.open_folder(DATA)
    for read in frames.some(1):
        frame = read()
        for one in frame.instances:
            found = locate(frames.models[one.name], 10 * np.nan_to_num(frame.depth), frame.camera)
            assert not len(found.weights), one.name
