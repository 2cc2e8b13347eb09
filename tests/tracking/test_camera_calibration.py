"""A camera is calibrated by the hand in its images, if enough of them agree."""

import dataclasses
import re
from importlib.util import find_spec

import numpy as np
import pytest

import handsight as hs
from cli.commands import called
from cli.tracks import recorded
from handsight import se3
from handsight.observation import Observation
from handsight.rig import MountedCamera
from handsight.rig.save import write as write_rig
from testbed.sight_scenes import WIDE, hand_scene

if find_spec("gymnasium_robotics") is None:  # it is not imported: only its files are used
    pytest.skip("the Shadow hand's files come with handsight[sim]", allow_module_level=True)

from handsight.simulation import Scenario, rig_of
from handsight.tracking import HandViews
from handsight.tracking.camera_calibration import MIN_VIEWS, VIEW_PERIOD

TRUE = se3.compose(se3.rotation_exp(np.array([0.3, 1.2, -0.4])), np.array([0.4, -0.3, 0.5]))
OFF = se3.compose(se3.rotation_exp(np.deg2rad([2.0, -3.0, 1.5])), np.array([0.02, -0.015, 0.03]))


def pictures(rig, count, T_world_camera=TRUE):
    """Observations of a hand that turns before the camera."""
    box = hs.ObjectModel.box((0.05, 0.07, 0.12))
    shapes = rig.hand.shape(), (box.vertices, box.faces), None
    for k in range(count):
        scene = hand_scene(rig.hand, shapes, np.random.default_rng(k), sigma_joint=0.0)
        T = T_world_camera @ scene.T_camera_palm
        yield Observation(k * VIEW_PERIOD, joint_positions=scene.joints, T_world_palm=T, depth=scene.depth)


def rig_with(T_world_camera, **changes):
    camera = MountedCamera(
        T_mount_camera=T_world_camera,
        intrinsics=WIDE.matrix,
        size=WIDE.size,
        sigma_position_constant=0.03,
        sigma_rotation_constant=np.deg2rad(3),
    )
    return dataclasses.replace(
        rig_of(Scenario(object="can", images=True)), camera=dataclasses.replace(camera, **changes)
    )


@pytest.mark.slow
def test_the_calibrated_camera_is_where_images_of_the_hand_were_taken():
    rig = rig_with(OFF @ TRUE)
    views = HandViews(rig)
    passed = list(views.watched(pictures(rig, 7)))
    assert len(passed) == views.images == 7
    found = views.calibration()
    assert found.views >= MIN_VIEWS
    E = found.T_mount_camera @ se3.inverse(TRUE)
    assert np.linalg.norm(se3.apply(E, found.pivot[None])[0] - found.pivot) < 0.003
    assert np.linalg.norm(se3.rotation_log(E[:3, :3])) < np.deg2rad(1)
    back = se3.inverse(OFF)
    true = np.r_[se3.apply(back, found.pivot[None])[0] - found.pivot, se3.rotation_log(back[:3, :3])]
    assert np.abs((found.correction - true) / np.sqrt(found.covariance.diagonal())).max() < 3
    T = se3.compose(se3.rotation_exp(found.correction[3:]), np.zeros(3))
    T[:3, 3] = found.pivot + found.correction[:3] - T[:3, :3] @ found.pivot
    np.testing.assert_allclose(T @ rig.camera.T_mount_camera, found.T_mount_camera, atol=1e-9)


def test_the_command_calibrates_a_camera_by_a_recordings_images(tmp_path, monkeypatch, capsys):
    rig = rig_with(OFF @ TRUE)
    write_rig(rig, tmp_path / "rig.yaml")
    recorded(tmp_path / "hand.mcap", pictures(rig, MIN_VIEWS), rig)
    unknown = dataclasses.replace(rig.camera, intrinsics=None, size=None)
    write_rig(dataclasses.replace(rig, camera=unknown), tmp_path / "without.yaml")
    command = "calibrate", "camera", "hand.mcap", "--object", "can", "--rig"
    assert called(monkeypatch, tmp_path, *command, "rig.yaml") == 0
    out = capsys.readouterr().out
    # A CameraInfo of the recording stands for intrinsics in the rig.
    assert called(monkeypatch, tmp_path, *command, "without.yaml") == 0
    assert capsys.readouterr().out == out
    assert f"# from the hand seen in {MIN_VIEWS} of {MIN_VIEWS} pictures" in out
    assert "touch says" not in out
    place = np.array(re.search(r"position: \[([^]]+)\]", out)[1].split(","), dtype=float)
    # The hand is up to 1.1 m off, and the turn known to some tenths of a degree.
    assert np.linalg.norm(place - TRUE[:3, 3]) < 0.012
    assert np.linalg.norm((OFF @ TRUE)[:3, 3] - TRUE[:3, 3]) > 0.03


def test_there_is_no_calibration_without_images_or_intrinsics():
    rig = rig_with(TRUE)
    few = [
        Observation(0.0, joint_positions={}, T_world_palm=np.eye(4), depth=np.ones((480, 640), np.float32)),
        Observation(1.0, T_world_palm=np.eye(4)),
    ]
    for each in (rig, rig_with(TRUE, intrinsics=None, size=None)):
        views = HandViews(each)
        assert list(views.watched(few)) == few
        assert views.calibration() is None
        assert views.images == 0  # joints are missing, or no depth
