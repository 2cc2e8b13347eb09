"""An object that images show alike after half a turn: both poses are kept until images and touch have chosen."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight import se3
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.vision import ObjectDetection
from handsight.vision.candidates import candidates_at
from tests.tracking.test_images import WRONG, error, pictures, rig_with_images
from tests.vision.test_depth_tracker import wedge


def half_turn(model):
    """The pose (4, 4) of an object that was turned by half a turn about the vertical axis through its middle."""
    R = np.diag([-1.0, -1.0, 1.0])
    return se3.compose(R, model.center_object - R @ model.center_object)


@pytest.mark.parametrize(("difference", "told"), [(0.002, False), (0.03, True)])
def test_of_two_poses_that_images_show_alike_the_answer_has_both_until_one_has_won(
    tmp_path, difference, told
):
    """The source has both, and the wrong one first."""
    file = tmp_path / "wedge.stl"
    trimesh.Trimesh(*wedge(difference), process=False).export(file)
    scenario = Scenario(object=str(file), seed=1, rate=25.0)
    samples = list(simulate(scenario))
    rig = rig_with_images(rig_of(scenario))
    model = model_of(scenario)
    images = pictures(rig, model, samples, every=3)
    T_camera_world = se3.inverse(rig.camera.T_mount_camera) @ WRONG
    T_now = np.eye(4)

    def both(*_, **__):
        Ts = np.stack([T_now @ half_turn(model), T_now])
        covariances = np.stack([1e-6 * np.eye(6)] * 2)
        return ObjectDetection(Ts, covariances, np.array([0.55, 0.45]), candidates_at(Ts), 0.9)

    tracker = hs.Tracker(rig, model, source=both)
    states = []
    for image, sample in zip(images, samples, strict=True):
        T_now = T_camera_world @ sample.observation.T_world_palm @ sample.T_palm_object
        estimate = tracker.update(replace(image, wrenches=sample.observation.wrenches))
        turns = [
            error(model, replace(estimate, modes=np.array([mode])), sample.T_palm_object)[1]
            for mode in estimate.modes
        ]
        assert min(turns) < np.deg2rad(15)
        wrong = turns[0] > np.deg2rad(90)
        assert tracker.state != "tracking" or not wrong
        states.append(tracker.state)
    assert states[0] == "uncertain"
    if told:
        shift, turn = error(model, estimate, samples[-1].T_palm_object)
        assert states[-1] == "tracking"
        assert shift < 0.006
        assert turn < np.deg2rad(5)
    else:
        assert states[-1] == "uncertain"
        assert len(estimate.hypotheses) == 2


def test_poses_that_touch_alone_cannot_tell_apart_stay_hypotheses_where_no_image_has_rivals():
    scenario = Scenario(object="can", seed=2, rate=25.0)
    tracker = hs.Tracker(rig_of(scenario), model_of(scenario))
    several = 0
    for sample in simulate(scenario):
        estimate = tracker.update(sample.observation)
        likely = [mode for mode in estimate.modes[1:] if mode["weight"] > 0.05]
        several += len(estimate.hypotheses) > 1
        assert tracker.state != "tracking" or not likely
    assert several > 5
