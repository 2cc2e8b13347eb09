import subprocess
import sys

import numpy as np
import pytest
import trimesh

from handsight import se3
from handsight.errors import InvalidFile, InvalidInput, InvalidObject, MissingExtra
from handsight.simulation import Nuisances, Scenario, model_of, rig_of, scene, simulate
from simulation.simulated import only
from testbed.refusals import refused


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"object": "cup"}, "object"),
        ({"object": 3}, "object"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"motion": "throw"}, "motion"),
        ({"nuisances": {"force_noise": 0}}, "nuisances"),
        ({"rate": 0}, "rate"),
        ({"rate": 30}, "rate"),
        ({"rate": 1000}, "rate"),
        ({"rate": 1e9}, "rate"),
        ({"rate": 5e-324}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"images": "no"}, "images"),
    ],
)
def test_a_wrong_scenario_is_rejected_with_the_reason(arguments, field):
    with refused(InvalidInput, field):
        Scenario(**arguments)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"force_noise": -0.01}, "force_noise"),
        ({"joint_offset": float("nan")}, "joint_offset"),
        ({"object_scale": 3.0}, "object_scale"),
        ({"friction": 0.0}, "friction"),
        ({"vision_delay": 1e300}, "vision_delay"),
        ({"table_tilt": 1e200}, "table_tilt"),
    ],
)
def test_a_wrong_nuisance_is_rejected_with_the_reason(arguments, field):
    with refused(InvalidInput, field):
        Nuisances(**arguments)


def test_without_nuisances_all_errors_are_zero_and_the_scale_is_one():
    values = {name: getattr(Nuisances.none(), name) for name in Nuisances.__slots__}
    assert values.pop("object_scale") == values.pop("friction") == 1.0
    assert values.pop("object_mass") == 0.15
    assert values.pop("vision_drift_time") == Nuisances().vision_drift_time  # of a drift of size zero
    assert set(values.values()) == {0.0}


def test_meshes_that_cannot_be_used_are_errors(tmp_path):
    with refused(InvalidFile, "none.stl"):
        next(simulate(Scenario(object=str(tmp_path / "none.stl"))))
    large = tmp_path / "large.stl"
    trimesh.creation.box((60, 90, 140)).export(large)
    with refused(InvalidObject, "large.stl"):
        next(simulate(Scenario(object=str(large))))
    flat = tmp_path / "flat.off"
    flat.write_text("OFF\n4 2 0\n0 0 0\n.1 0 0\n.1 .1 0\n0 .1 0\n3 0 1 2\n3 0 2 3\n")
    with refused(InvalidObject, "flat.off"):
        next(simulate(Scenario(object=str(flat))))


def test_a_missing_extra_is_named(monkeypatch):
    scene.scene.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(scene, "find_spec", lambda name: None)
        with refused(MissingExtra, "simulation needs gymnasium-robotics"):
            next(simulate(Scenario()))
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mujoco", None)
        with refused(MissingExtra, "simulation needs mujoco"):
            next(simulate(Scenario()))


def test_importing_the_room_loads_no_simulator():
    code = "import sys, handsight.simulation; print([m for m in ('mujoco', 'OpenGL', 'gymnasium') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_rig_is_the_same_for_all_seeds_and_nuisances():
    a, b = rig_of(Scenario(seed=1)), rig_of(Scenario(seed=2, nuisances=Nuisances.none()))
    np.testing.assert_array_equal(a.camera.T_mount_camera, b.camera.T_mount_camera)
    assert a.hand is b.hand
    for name, finger in a.fingers.items():
        np.testing.assert_array_equal(finger.calibration.bias_force, b.fingers[name].calibration.bias_force)
        assert finger.frame == a.hand.tips[name]
    assert list(a.fingers) == ["ff", "mf", "rf", "lf", "th"]
    se3.check(a.camera.T_mount_camera, "camera")


def test_the_robots_model_has_the_size_that_the_nuisances_state():
    exact = model_of(Scenario())
    np.testing.assert_allclose(np.ptp(exact.bounds_object, axis=0), [0.066, 0.066, 0.122])
    larger = model_of(Scenario(nuisances=only(object_scale=1.03)))
    np.testing.assert_allclose(larger.bounds_object, 1.03 * exact.bounds_object)
