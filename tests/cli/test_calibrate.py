"""A camera's constant error from a recording in which the palm turns."""

import dataclasses
import re

import numpy as np
import pytest
from ruamel.yaml import YAML

from cli.commands import called
from cli.tracks import recorded, recorded_observations
from forces.test_loads import in_the_air
from handsight import se3
from handsight.errors import InvalidInput
from handsight.forces import calibrate_sensors
from handsight.rig import Rig
from handsight.rig.save import write as write_rig
from handsight.simulation import Scenario, rig_of, true_camera
from handsight.tracking import calibrate_camera
from testbed.refusals import refused


@pytest.fixture(scope="session")
def moved(simulated, tmp_path_factory):
    """A scenario in which the palm turns with the box, recorded, and its rig."""
    scenario = Scenario(object="box", rate=20, motion="manipulate")
    rig, folder = rig_of(scenario), tmp_path_factory.mktemp("moved")
    return scenario, rig, recorded(folder / "box.mcap", (s.observation for s in simulated(scenario)), rig)


@pytest.fixture(scope="session")
def calibrated(moved):
    _, rig, path = moved
    return calibrate_camera(recorded_observations(path, rig), rig, rig.objects["box"].model())


def test_the_cameras_displacement_is_found_where_the_palm_turned(moved, calibrated):
    scenario, rig, _ = moved
    found = calibrated
    assert np.rad2deg(found.turned) > 60
    # What the camera sees is displaced, so the camera is where that takes it back from.
    back = se3.inverse(rig_of(scenario).camera.T_mount_camera @ true_camera(scenario))
    true = np.r_[se3.apply(back, found.pivot[None])[0] - found.pivot, se3.rotation_log(back[:3, :3])]
    sigma = np.sqrt(found.covariance.diagonal())
    assert np.linalg.norm(true[:3]) > 0.05
    assert np.abs((found.correction - true) / sigma).max() < 3
    assert np.linalg.norm(found.correction[:3] - true[:3]) < 0.15 * np.linalg.norm(true[:3])
    T = np.eye(4)
    T[:3, :3] = se3.rotation_exp(found.correction[3:])
    T[:3, 3] = found.pivot + found.correction[:3] - T[:3, :3] @ found.pivot
    np.testing.assert_allclose(T @ rig.camera.T_mount_camera, found.T_mount_camera, atol=1e-9)


def test_calibrate_camera_prints_what_the_rig_file_takes(moved, calibrated, asked, tmp_path):
    _, rig, path = moved
    write_rig(rig, tmp_path / "rig.yaml")
    out, err = asked("calibrate", "camera", path, "--rig", "rig.yaml", "--object", "box")
    assert re.search(r"# known to ± \[[\d., ]+\] mm, \[[\d., ]+\]° \(one standard deviation\)", out)
    assert err == ""
    text = (tmp_path / "rig.yaml").read_text()
    pose = next(line for line in out.splitlines() if line.startswith("  pose: "))
    (tmp_path / "new.yaml").write_text(
        re.sub(r"(?m)(?<=^camera:)(.*\n.*\n)  pose: .*$", lambda found: found[1] + pose, text)
    )
    found = Rig.from_file(tmp_path / "new.yaml").camera.T_mount_camera
    np.testing.assert_allclose(found, calibrated.T_mount_camera, atol=1e-3)


def test_a_camera_that_is_not_there_cannot_be_calibrated(moved, tmp_path, monkeypatch, capsys):
    _, rig, path = moved
    seen, model = recorded_observations(path, rig)[:40], rig.objects["box"].model()
    with refused(InvalidInput, "camera"):
        calibrate_camera(seen, dataclasses.replace(rig, camera=None), model)
    blind = [dataclasses.replace(observation, vision=None) for observation in seen]
    assert calibrate_camera(blind, rig, model) is None
    recorded(tmp_path / "blind.mcap", blind, rig)
    write_rig(rig, tmp_path / "rig.yaml")
    assert called(monkeypatch, tmp_path, "calibrate", "camera", "blind.mcap", "--object", "box") == 2
    said = "handsight: blind.mcap: expected an object that is held and visible, got none: no pose yet"
    assert capsys.readouterr().err.startswith(said)


def test_calibrate_sensors_prints_what_the_rig_file_takes(asked, tmp_path):
    rig, seen = rig_of(Scenario()), list(in_the_air(0.2))
    path = recorded(tmp_path / "air.mcap", seen, rig)
    write_rig(rig, tmp_path / "rig.yaml")
    out, err = asked("calibrate", "sensors", path, "--rig", "rig.yaml")
    expected = calibrate_sensors(rig, seen).fingers["ff"]
    printed = YAML(typ="safe").load(out)["fingers"]["ff"]["sensor"]
    assert printed["noise"]["force"] == pytest.approx(expected.sigma_force, rel=0.02)
    assert printed["tip_mass"] == pytest.approx(expected.calibration.mass, rel=0.02)
    np.testing.assert_allclose(printed["bias"]["force"], expected.calibration.bias_force, atol=2e-3)
    assert re.search(r"ff: readings are off by \d+ mN, .* the rig has 10 mN", err)
    assert "mf: readings" not in err
