import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput, MissingExtra
from handsight.simulation import (
    Scenario,
    camera_facing,
    model_of,
    rig_of,
    simulate,
    true_camera,
)
from handsight.simulation.camera import TARGET, calibration_error
from simulation.simulated import NONE, only, samples
from testbed.pictures import render
from testbed.refusals import refused


def vision_world(sample):
    """The object's pose (4, 4) in the world as vision measures it."""
    return rig_of(Scenario()).camera.T_mount_camera @ sample.observation.vision.T_frame_object


def test_without_nuisances_vision_is_right():
    for sample in samples():
        np.testing.assert_allclose(vision_world(sample), sample.T_world_object, atol=1e-12)


def test_vision_is_wrong_by_8_cm_on_average_over_the_table_as_in_the_paper():
    moved = np.array(
        [se3.apply(calibration_error(Scenario(seed=seed)), TARGET[None])[0] - TARGET for seed in range(1000)]
    )
    np.testing.assert_allclose(np.linalg.norm(moved[:, :2], axis=1).mean(), 0.08, rtol=0.05)
    np.testing.assert_allclose(moved[:, 2].std(), 0.064, rtol=0.1)
    turns = [se3.rotation_log(calibration_error(Scenario(seed=seed))[:3, :3]) for seed in range(1000)]
    np.testing.assert_allclose(np.std(turns), np.deg2rad(6), rtol=0.05)


def test_a_wrong_camera_is_wrong_by_one_rigid_motion_of_the_world():
    nuisances = only(camera_position=0.08, camera_height=0.064, camera_rotation=0.1)
    T_measured_true = calibration_error(Scenario(nuisances=nuisances, seed=4))
    for sample in samples("can", 4, "manipulate", 5.0, nuisances):
        if sample.observation.vision is not None:
            np.testing.assert_allclose(
                vision_world(sample), T_measured_true @ sample.T_world_object, atol=1e-12
            )


def test_white_noise_of_vision_has_the_stated_sigma():
    run = samples("can", 0, "manipulate", 10.0, only(vision_position=0.005, vision_rotation=0.05))
    camera = se3.inverse(rig_of(Scenario()).camera.T_mount_camera)
    wrong = np.array(
        [se3.difference(s.observation.vision.T_frame_object, camera @ s.T_world_object) for s in run]
    )
    np.testing.assert_allclose(wrong[:, :3].std(axis=0), 0.005, rtol=0.2)
    np.testing.assert_allclose(wrong[:, 3:].std(axis=0), 0.05, rtol=0.2)


def test_poses_come_ten_times_a_second_and_images_thirty_times():
    run = samples(rate=50.0)
    seen = [s.observation.stamp for s in run if s.observation.vision is not None]
    np.testing.assert_allclose(np.diff(seen), 0.1, atol=1e-9)
    stream, stamps = simulate(Scenario(rate=50.0, images=True, nuisances=NONE)), []
    for sample, _ in zip(stream, range(11), strict=False):
        if sample.observation.color is not None:
            stamps.append(sample.observation.stamp)
    stream.close()
    assert len(stamps) == 7  # within 0.2 s
    assert np.diff(stamps).max() < 0.05


def test_depth_images_show_the_object_where_it_is():
    nuisances = only(camera_position=0.05, camera_height=0.03, camera_rotation=0.05)
    scenario = Scenario(object="box", rate=1.0, images=True, nuisances=nuisances)
    sample = list(simulate(scenario))[-1]
    rig, model = rig_of(scenario), model_of(scenario)
    T_camera_object = true_camera(scenario) @ sample.T_world_object
    points, normals = model.sample(4000)
    points_camera, facing = se3.apply(T_camera_object, points), normals @ T_camera_object[:3, :3].T
    pixels = points_camera @ rig.camera.intrinsics.T
    u, v = np.round(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    bare = (facing * points_camera).sum(axis=1) < -0.3 * points_camera[:, 2]
    off = sample.observation.depth[v, u] - points_camera[:, 2]
    assert bare.sum() > 500
    # The rest is behind fingers, or shares a pixel with an edge.
    assert np.mean(np.abs(off[bare]) < 0.002) > 0.8
    assert abs(np.nanmedian(off[bare])) < 1e-4
    greener = sample.observation.color[v, u][bare].astype(float)
    assert np.mean(greener[:, 1] > greener[:, 0]) > 0.8


def test_what_cannot_be_drawn_is_an_error(monkeypatch):
    sample = samples()[-1]
    with refused(InvalidInput, "at - eye"):
        camera_facing([0, 0, 1], [0, 0, 1])
    short = type(sample)(
        **{f: getattr(sample, f) for f in sample.__slots__ if f != "configuration"}, configuration=np.zeros(3)
    )
    with refused(InvalidInput, "sample"):
        render(Scenario(), short)

    def absent(name):
        raise ImportError(f"no library for {name}")

    monkeypatch.setattr("handsight.simulation.camera.import_module", absent)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(MissingExtra):
        render(Scenario(), sample)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(MissingExtra):
        next(simulate(Scenario(images=True)))
