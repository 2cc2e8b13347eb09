import re

import numpy as np
import pytest

from handsight.contact import Ellipsoid, Sphere, parse_fingertip, unambiguous_cap
from handsight.errors import InvalidInput, InvalidTransform


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"semi_axes": [8, 8, 12]},
            "semi_axes[0]: expected metres, at most 0.2, got 8 (millimetres? 0.008 m)",
        ),
        ({"semi_axes": [0.008, 0.008, -1]}, "semi_axes[2]: expected metres, at least 1e-05, got -1"),
        ({"semi_axes": [0.008, 0, 0.012]}, "semi_axes[1]: expected metres, at least 1e-05, got 0"),
        (
            {"semi_axes": [0.008, np.nan, 0.01]},
            "semi_axes: expected 3 finite numbers, got [0.008, nan, 0.01]",
        ),
        ({"semi_axes": 0.008}, "semi_axes: expected 3 finite numbers, got 0.008"),
        ({"cap": 0.012}, "cap: expected metres within the tip's ends ±0.012, got 0.012"),
        ({"cap": -3}, "cap: expected metres within the tip's ends ±0.012, got -3 (millimetres? -0.003 m)"),
        ({"cap": np.inf}, "cap: expected a finite number, got inf"),
        ({"max_friction": 0}, "max_friction: expected a number above 0, got 0"),
        ({"min_force": -1}, "min_force: expected a number above 0, got -1"),
        ({"min_force": 1e-12}, "min_force: expected newtons, at least 1e-09, got 1e-12"),
        (
            {"T_surface_sensor": np.eye(3)},
            "T_surface_sensor: expected finite numbers of shape (4, 4), got shape (3, 3)",
        ),
    ],
)
def test_a_wrong_ellipsoid_is_refused_by_field(arguments, message):
    with pytest.raises(InvalidInput, match=f"^{re.escape(message)}$"):
        Ellipsoid(**{"semi_axes": (0.008, 0.008, 0.012), **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"radius": 9}, "radius: expected metres, at most 0.2, got 9 (millimetres? 0.009 m)"),
        ({"radius": 0}, "radius: expected a number above 0, got 0"),
        ({"cap": 0.01}, "cap: expected metres within the tip's ends ±0.009, got 0.01"),
    ],
)
def test_a_wrong_sphere_is_refused_by_field(arguments, message):
    with pytest.raises(InvalidInput, match=f"^{re.escape(message)}$"):
        Sphere(**{"radius": 0.009, **arguments})


def test_a_sensor_s_pose_must_be_rigid():
    with pytest.raises(InvalidTransform, match="T_surface_sensor: rotation is not orthonormal"):
        Sphere(0.009, T_surface_sensor=2 * np.eye(4))


def test_a_shape_cannot_be_changed_afterwards():
    axes = np.array([0.008, 0.008, 0.012])
    tip = Ellipsoid(axes, T_surface_sensor=np.eye(4))
    axes[0] = 1
    assert tip.semi_axes[0] == 0.008
    with pytest.raises(ValueError, match="read-only"):
        tip.semi_axes[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        tip.T_surface_sensor[0, 0] = 2
    with pytest.raises(AttributeError):
        tip.cap = 0.001


def test_the_unambiguous_cap_of_a_sphere_is_where_friction_can_point_sideways():
    # On a sphere the normal leans by the polar angle: that and the friction angle make a right angle.
    cap = unambiguous_cap(Sphere(0.01, max_friction=0.75))
    assert np.arccos(cap / 0.01) + np.arctan(0.75) == pytest.approx(np.pi / 2)
    with pytest.raises(InvalidInput, match="expected a max_friction"):
        unambiguous_cap(Sphere(0.01))


@pytest.mark.parametrize(
    "text",
    [
        "ellipsoid:8,9,12mm;cap=-2mm;friction=1.2;min_force=0.2N;sensor=0,1,-20mm",
        " Ellipsoid: 0.8cm, 9mm, 0.012 m , cap = -0.2cm, sensor=0,1,-20mm, friction=1.2, min_force=.2",
    ],
)
def test_a_typed_ellipsoid_is_in_metres(text):
    tip = parse_fingertip(text)
    assert isinstance(tip, Ellipsoid)
    np.testing.assert_allclose(tip.semi_axes, [0.008, 0.009, 0.012])
    assert tip.cap == pytest.approx(-0.002)
    assert (tip.max_friction, tip.min_force) == (1.2, 0.2)
    np.testing.assert_array_equal(tip.T_surface_sensor[:3, :3], np.eye(3))
    np.testing.assert_allclose(tip.T_surface_sensor[:3, 3], [0, 0.001, -0.02])


def test_a_typed_sphere_has_the_defaults_of_a_sphere():
    tip, plain = parse_fingertip("sphere:9mm"), Sphere(0.009)
    assert isinstance(tip, Sphere)
    assert tip.radius == pytest.approx(0.009)
    assert (tip.cap, tip.max_friction, tip.min_force) == (plain.cap, plain.max_friction, plain.min_force)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected ellipsoid:A,B,Cmm or sphere:Rmm, got ''"),
        ("cube:8mm", "expected ellipsoid:A,B,Cmm or sphere:Rmm, got 'cube:8mm'"),
        ("ellipsoid", "expected ellipsoid:A,B,Cmm or sphere:Rmm, got 'ellipsoid'"),
        ("ellipsoid:8,8mm", "ellipsoid: expected 3 lengths such as 8,8,12mm, got '8,8mm'"),
        ("ellipsoid:8,x,12mm", "ellipsoid: expected 3 lengths such as 8,8,12mm, got '8,x,12mm'"),
        ("ellipsoid:8,8,12", "ellipsoid: expected mm, cm or m in '8,8,12', got no unit"),
        ("sphere:9in", "sphere: expected mm, cm or m in '9in', got the unit 'in'"),
        ("sphere:", "sphere: expected a length such as 9mm, got ''"),
        ("sphere:nanmm", "sphere: expected a length such as 9mm, got 'nanmm'"),
        (
            "sphere:9m",
            "fingertip 'sphere:9m': radius: expected metres, at most 0.2, got 9 (millimetres? 0.009 m)",
        ),
        ("sphere:9mm;cap=9mm", "cap: expected metres within the tip's ends ±0.009, got 0.009"),
        ("sphere:9mm;cap=0", "cap: expected mm, cm or m in '0', got no unit"),
        ("sphere:9mm;cap=0mm,1mm", "cap: expected a length such as 9mm, got '0mm,1mm'"),
        ("sphere:9mm;friction=1N", "friction: expected a number, got '1N'"),
        ("sphere:9mm;min_force=1kg", "min_force: expected a number [N], got '1kg'"),
        ("sphere:9mm;sensor=1,2mm", "sensor: expected 3 lengths such as 8,8,12mm, got '1,2mm'"),
        ("sphere:9mm;mu=1", "expected options cap, friction, min_force, sensor, got 'mu'"),
        ("sphere:9mm;cap=0mm;cap=1mm", "expected cap once, got it twice"),
    ],
)
def test_a_fingertip_typed_wrongly_is_quoted(text, message):
    with pytest.raises(InvalidInput, match=f"{re.escape(message)}$"):
        parse_fingertip(text)
