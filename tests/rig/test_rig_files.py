"""A rig that was written is read as the same rig; files it names are found from where it lies."""

import dataclasses
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.contact import Ellipsoid, Sphere, TactileSurface, WrenchCalibration
from handsight.contact.taxels import Grid
from handsight.errors import InvalidFile, MissingExtra
from handsight.hand import Hand
from handsight.objects import ObjectSpec
from handsight.rig import Finger, MountedCamera, Rig, Table, Topics
from handsight.rig.save import text, write
from rig.rigs import TIPS, URDF, full, hand, rig_text
from testbed.refusals import refused

VALUES = (Rig, Finger, MountedCamera, Table, Topics, ObjectSpec, TactileSurface, WrenchCalibration)


def leaves(value, path=""):
    """(path, value) of everything in a rig."""
    if isinstance(value, VALUES):
        for item in (item for item in dataclasses.fields(value) if item.init):
            yield from leaves(getattr(value, item.name), f"{path}.{item.name}")
    elif isinstance(value, Hand):
        yield from leaves({"palm": value.palm, "tips": value.tips, "joints": value.joint_names}, path)
        yield f"{path}.file", Path(value.file).absolute() if "://" not in value.file else value.file
    elif isinstance(value, Ellipsoid | Sphere):
        yield f"{path}.kind", type(value).__name__
        for name in ("semi_axes", "cap", "max_friction", "min_force", "T_surface_sensor"):
            yield f"{path}.{name}", getattr(value, name)
    elif isinstance(value, Grid):
        yield from leaves(value._asdict(), path)
    elif isinstance(value, dict):
        yield f"{path}.keys", list(value)
        for key, part in value.items():
            yield from leaves(part, f"{path}[{key!r}]")
    else:
        yield path, value


def assert_same(a, b):
    a, b = dict(leaves(a)), dict(leaves(b))
    assert list(a) == list(b)
    for path, value in a.items():
        if isinstance(value, np.ndarray | float):
            np.testing.assert_allclose(b[path], value, rtol=1e-10, atol=1e-11, err_msg=path)
        elif isinstance(value, tuple) and value and isinstance(value[0], float):
            np.testing.assert_allclose(b[path], value, rtol=1e-10, err_msg=path)
        else:
            assert b[path] == value, path


def read(folder, content, name="rig.yaml"):
    path = Path(folder) / name
    path.write_text(content, encoding="utf-8")
    return Rig.from_file(path)


size = st.floats(1e-6, 0.19)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.tuples(size, size, size), st.sampled_from(["joints", "tf", None]))
def test_what_was_written_is_read_as_the_same_rig(tmp_path_factory, seed, numbers, world_from):
    folder = tmp_path_factory.getbasetemp() / "written"
    folder.mkdir(exist_ok=True)
    rig = full(folder, seed, numbers, world_from)
    assert_same(rig, read(folder, text(rig)))


def test_a_rig_of_the_simulator_is_read_as_the_same_rig(tmp_path):
    pytest.importorskip("mujoco")
    if find_spec("gymnasium_robotics") is None:
        pytest.skip("the Shadow hand is in gymnasium-robotics, which is not installed")
    from handsight.simulation import Scenario, rig_of

    for scenario in (Scenario(), Scenario(images=True)):
        rig = rig_of(scenario)
        write(rig, tmp_path / "rig.yaml")
        assert_same(rig, Rig.from_file(tmp_path / "rig.yaml"))


def test_the_shortest_rig_is_the_usual_one(tmp_path):
    hand(tmp_path)
    rig = read(
        tmp_path,
        """
version: 1
hand: {file: pinch.urdf, palm: palm}
fingers:
  index: {frame: index_tip, tip: {sphere: 0.01}, sensor: {reading: on_tip}}
""",
    )
    assert_same(
        rig,
        Rig(
            hand=Hand.from_file(tmp_path / "pinch.urdf", palm="palm", tips={"index": "index_tip"}),
            fingers={
                "index": Finger(
                    frame="index_tip",
                    T_frame_surface=np.eye(4),
                    tip=Sphere(0.01, T_surface_sensor=np.eye(4)),
                    calibration=rig.fingers["index"].calibration,
                )
            },
            topics=Topics(wrenches={"index": "/index/wrench"}),
        ),
    )
    known = rig.fingers["index"].calibration
    assert (known.mass, known.reading) == (0, "on_tip")
    np.testing.assert_array_equal(np.r_[known.bias_force, known.bias_torque, known.center_of_mass], 0)


def test_a_finger_without_a_sensor_has_no_wrenches_and_is_written_so(tmp_path):
    hand(tmp_path)
    rig = read(
        tmp_path,
        """
version: 1
hand: {file: pinch.urdf, palm: palm}
fingers:
  index: {frame: index_tip, tip: {sphere: 0.01}}
  thumb: {frame: thumb_tip, tip: {sphere: 0.01}, sensor: {reading: on_tip}}
""",
    )
    assert rig.topics.wrenches == {"thumb": "/thumb/wrench"}
    assert not rig.fingers["index"].calibration.mass
    write(rig, tmp_path / "again.yaml")
    written = (tmp_path / "again.yaml").read_text()
    assert written.count("sensor:") == 1
    assert_same(Rig.from_file(tmp_path / "again.yaml"), rig)


def test_taxels_at_any_places_are_written_to_tables_beside_the_rig(tmp_path):
    """One for all links of one shape; they are the same when they are read."""
    hand(tmp_path)
    table = "[[0, 0, 0.005, 0, 0, 1], [0, 0.004, 0.005, 0, 0.1, 1], [0.004, 0, 0.005, 0.1, 0, 1]]"
    other = table.replace("0.004", "0.006")
    lines = (f"{name}: {{frame: {name}_tip, taxels: {table}, threshold: 0.1}}" for name in ("index", "thumb"))
    rig = read(
        tmp_path,
        """
version: 1
hand: {file: pinch.urdf, palm: palm}
fingers: {index: {frame: index_tip, tip: {sphere: 0.01}}}
skin:
"""
        + "".join(f"  {line}\n" for line in lines)
        + f"  palm: {{frame: palm, taxels: {other}, threshold: 0.1}}\n",
    )
    write(rig, tmp_path / "again.yaml")
    assert sorted(path.name for path in tmp_path.glob("*.csv")) == ["again.index.csv", "again.palm.csv"]
    again = Rig.from_file(tmp_path / "again.yaml")
    for name, surface in rig.skin.items():
        np.testing.assert_allclose(again.skin[name].points, surface.points, atol=1e-11)
        np.testing.assert_allclose(again.skin[name].taxels["axes"], surface.taxels["axes"], atol=1e-8)


def test_fingers_may_share_what_they_have_in_common(tmp_path):
    hand(tmp_path)
    rig = read(
        tmp_path,
        """
version: 1
hand: {file: pinch.urdf, palm: palm}
fingers:
  index: &usual {frame: index_tip, tip: &tip {sphere: 0.01}, sensor: {reading: on_tip}}
  thumb: {<<: *usual, frame: thumb_tip, sigma_point: 0.002}
""",
    )
    assert [finger.frame for finger in rig.fingers.values()] == list(TIPS.values())
    assert [finger.tip.radius for finger in rig.fingers.values()] == [0.01, 0.01]
    assert [finger.sigma_point for finger in rig.fingers.values()] == [5e-4, 0.002]


def test_files_are_beside_the_rig_whatever_the_folder_one_is_in(tmp_path, monkeypatch):
    (tmp_path / "a" / "hands").mkdir(parents=True)
    (tmp_path / "a" / "hands" / "pinch.urdf").write_text(URDF)
    content = rig_text(tmp_path).replace(f"{tmp_path}/pinch.urdf", "hands/pinch.urdf")
    content = content.replace(f"{tmp_path}/mug.stl", "mug.stl")
    (tmp_path / "a" / "rig.yaml").write_text(content)
    monkeypatch.chdir(tmp_path)
    rig = Rig.from_file("a/rig.yaml")
    assert rig.objects["mug"].mesh == Path("a/mug.stl")
    # Written elsewhere, it still finds them.
    (tmp_path / "b").mkdir()
    write(rig, Path("b/rig.yaml"))
    assert_same(full(tmp_path / "a" / "hands").hand, Rig.from_file("b/rig.yaml").hand)
    assert Rig.from_file("b/rig.yaml").objects["mug"].mesh == tmp_path / "a" / "mug.stl"


def test_a_package_is_found_above_the_rig_file(tmp_path, monkeypatch):
    (tmp_path / "pinch_description" / "urdf").mkdir(parents=True)
    (tmp_path / "pinch_description" / "urdf" / "pinch.urdf").write_text(URDF)
    (tmp_path / "robot" / "config").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    name = "package://pinch_description/urdf/pinch.urdf"
    rig = read(tmp_path / "robot" / "config", rig_text(tmp_path).replace(f"{tmp_path}/pinch.urdf", name))
    assert rig.hand.file == name
    assert f'file: "{name}"' in text(rig)


def test_a_rig_that_cannot_be_written_is_reported(tmp_path):
    with refused(InvalidFile, "rig.yaml"):
        write(full(tmp_path), tmp_path / "none" / "rig.yaml")


def test_the_packages_that_read_it_are_named(tmp_path, monkeypatch):
    content = rig_text(tmp_path)
    for module, needs in (("ruamel.yaml", "YAML files need ruamel.yaml"), ("mujoco", "pinch.urdf")):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with refused(MissingExtra, needs):
                read(tmp_path, content)
