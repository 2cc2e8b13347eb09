import re
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from handsight import se3
from handsight.errors import InvalidFile, InvalidInput, InvalidObject, MissingExtra
from handsight.simulation import Nuisances, Scenario, model_of, rig_of, scene, simulate
from simulation.simulated import only


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"object": "cup"},
            "object: expected can, box, a mesh file (.stl, .obj, .ply, .off) or an object of the library, got 'cup'",
        ),
        (
            {"object": 3},
            "object: expected can, box, a mesh file (.stl, .obj, .ply, .off) or an object of the library, got 3",
        ),
        ({"seed": -1}, "seed: expected a whole number of at least 0, got -1"),
        ({"seed": 1.5}, "seed: expected a whole number of at least 0, got 1.5"),
        (
            {"motion": "throw"},
            "motion: expected one of grasp, manipulate, weigh, ramp, steps, sine, creep, jerks, got 'throw'",
        ),
        ({"nuisances": {"force_noise": 0}}, "nuisances: expected Nuisances, got dict"),
        ({"rate": 0}, "rate: expected a number above 0, got 0"),
        ({"rate": 30}, "rate: expected a divisor of 500 per second, got 30"),
        ({"rate": 1000}, "rate: expected a divisor of 500 per second, got 1000"),
        ({"rate": 1e9}, "rate: expected a divisor of 500 per second, got 1e+09"),
        ({"rate": 5e-324}, "rate: expected a divisor of 500 per second, got 4.94066e-324"),
        ({"rate": float("nan")}, "rate: expected a finite number, got nan"),
        ({"images": "no"}, "images: expected true or false, got 'no'"),
    ],
)
def test_a_wrong_scenario_is_rejected_with_the_reason(arguments, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        Scenario(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"force_noise": -0.01}, "force_noise: expected a number of at least 0, got -0.01"),
        ({"joint_offset": float("nan")}, "joint_offset: expected a finite number, got nan"),
        ({"object_scale": 3.0}, "object_scale: expected 0.5 to 2, got 3"),
        ({"friction": 0.0}, "friction: expected 0.1 to 2, got 0"),
        ({"vision_delay": 1e300}, "vision_delay: expected at most 100, got 1e+300"),
        ({"table_tilt": 1e200}, "table_tilt: expected at most 100, got 1e+200"),
    ],
)
def test_a_wrong_nuisance_is_rejected_with_the_reason(arguments, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        Nuisances(**arguments)


def test_without_nuisances_all_errors_are_zero_and_the_scale_is_one():
    values = {name: getattr(Nuisances.none(), name) for name in Nuisances.__slots__}
    assert values.pop("object_scale") == values.pop("friction") == 1.0
    assert values.pop("object_mass") == 0.15
    assert values.pop("vision_drift_time") == Nuisances().vision_drift_time  # of a drift of size zero
    assert set(values.values()) == {0.0}


def test_meshes_that_cannot_be_used_are_errors(tmp_path):
    with pytest.raises(InvalidFile, match=r"^none\.stl: cannot be read: No such file"):
        next(simulate(Scenario(object=str(tmp_path / "none.stl"))))
    large = tmp_path / "large.stl"
    trimesh.creation.box((60, 90, 140)).export(large)
    with pytest.raises(InvalidObject, match=r"^large\.stl: expected metres, at most 0\.5, got 140"):
        next(simulate(Scenario(object=str(large))))
    flat = tmp_path / "flat.off"
    flat.write_text("OFF\n4 2 0\n0 0 0\n.1 0 0\n.1 .1 0\n0 .1 0\n3 0 1 2\n3 0 2 3\n")
    with pytest.raises(InvalidObject, match=r"^flat\.off: expected a body with a volume, got none"):
        next(simulate(Scenario(object=str(flat))))
    wide = tmp_path / "wide.stl"
    trimesh.creation.box((0.3, 0.3, 0.1)).export(wide)
    with pytest.raises(
        InvalidObject, match=r"^object: expected one that fits in the open hand, got 300 x 300 x 100 mm"
    ):
        next(simulate(Scenario(object=str(wide))))


def test_a_missing_extra_is_named(monkeypatch):
    scene.scene.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(scene, "find_spec", lambda name: None)
        with pytest.raises(MissingExtra, match=r"gymnasium-robotics: pip install 'handsight\[sim\]'"):
            next(simulate(Scenario()))
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mujoco", None)
        with pytest.raises(MissingExtra, match=r"mujoco: pip install 'handsight\[sim\]'"):
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


def test_the_robots_model_is_scaled_dented_or_scanned_as_the_nuisances_state():
    exact = model_of(Scenario())
    np.testing.assert_allclose(np.ptp(exact.bounds_object, axis=0), [0.066, 0.066, 0.122])
    larger = model_of(Scenario(nuisances=only(object_scale=1.03)))
    np.testing.assert_allclose(larger.bounds_object, 1.03 * exact.bounds_object)
    for kind in ("can", "box"):
        whole = model_of(Scenario(object=kind))
        dented = model_of(Scenario(object=kind, seed=2, nuisances=only(object_dent=0.005)))
        depth = -whole.evaluate(dented.sample(20000)[0]).distance
        assert depth.max() == pytest.approx(0.005, rel=0.15)
        assert 0.02 < np.mean(depth > 0.001) < 0.4
        assert depth.min() > -0.001


def test_a_scanned_model_has_the_rest_of_the_scans_noise():
    scanned = model_of(Scenario(nuisances=only(object_scan=0.001)))
    off = model_of(Scenario()).evaluate(scanned.vertices).distance
    assert 5e-5 < np.std(off) < 5e-4  # a millimetre, smoothed
    assert abs(np.mean(off)) < 3e-4
