"""On real frames: frozen scores of stored poses, and the frozen gradient and information of the depth at true ones."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

from handsight import se3
from testbed import bop, real_frames
from vision.real_evidence import ANSWERS, EVIDENCE, frozen

NAMED = os.environ.get("HANDSIGHT_DATA")
DATA = (Path(NAMED) if NAMED else Path(__file__).parents[3] / "shared" / "data") / "ycbv_frames"
if not DATA.is_dir():
    pytest.skip("the real frames are not here: set HANDSIGHT_DATA to their folder", allow_module_level=True)
pytest.importorskip("PIL.Image", reason="PNG files come with handsight[robot]")


@pytest.fixture(scope="module")
def frames():
    return real_frames.open_folder(DATA)


def test_the_truth_scored_as_an_answer_is_right(frames):
    for read in frames.some(1):
        frame = read()
        assert len(frame.instances) >= 3
        for one in frame.instances:
            model, at = frames.models[one.name], one.T_camera_object
            assert bop.pose_errors(model, frame.camera, frame.depth, at, at).recalls == (1.0, 1.0, 1.0)
            assert bop.mssd(model, at, at) == 0
            assert real_frames.add_s(model, at, at) < 5e-3  # the field's own error


@pytest.mark.slow
def test_stored_answers_have_the_scores_that_they_had(frames):
    with ANSWERS.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 20
    wanted, read = {(row["scene"], row["frame"]) for row in rows}, {}
    for each in frames.some(1000):
        frame = each()
        if (frame.scene, frame.name) in wanted:
            read[frame.scene, frame.name] = frame
    for row in rows:
        frame, model = read[row["scene"], row["frame"]], frames.models[row["object"]]
        (one,) = (one for one in frame.instances if one.name == row["object"])
        numbers = {key: float(row[key]) for key in ("x", "y", "z", "qx", "qy", "qz", "qw", "ar")}
        quaternion_xyzw = np.array([numbers[f"q{key}"] for key in "xyzw"])
        T = se3.from_position_quaternion(
            [numbers[key] for key in "xyz"], quaternion_xyzw / np.linalg.norm(quaternion_xyzw)
        )
        errors = bop.pose_errors(model, frame.camera, frame.depth, one.T_camera_object, T)
        # Six digits are stored: a pose may come to lie on the other side of a threshold.
        assert np.mean(errors.recalls) == pytest.approx(numbers["ar"], abs=0.04), row
        if int(row["answered"]):
            s = real_frames.add_s(model, one.T_camera_object, T)
            assert (s < 0.1) == bool(int(row["right_s"])) or s == pytest.approx(0.1, abs=1e-4)
            assert (errors.mssd < 0.1) == bool(int(row["right_m"])) or errors.mssd == pytest.approx(
                0.1, abs=1e-4
            )


def test_gradient_and_information_at_true_poses_are_what_they_were(frames):
    known, found = json.loads(EVIDENCE.read_text(encoding="utf-8")), frozen(frames)
    assert list(found) == list(known)
    for name, one in found.items():
        scale = np.abs(known[name]["information"]).max()
        np.testing.assert_allclose(
            one["information"], known[name]["information"], atol=1e-4 * scale, rtol=0, err_msg=name
        )
        # Information times a step of a metre; a tenth of a millimetre of a step.
        np.testing.assert_allclose(one["gradient"], known[name]["gradient"], atol=1e-4 * scale * 1e-2, rtol=0)
        assert one["weight"] == pytest.approx(known[name]["weight"], rel=1e-4)
        np.linalg.cholesky(np.array(one["information"]))
