import numpy as np
import pytest

from handsight.contact import Ellipsoid, Sphere, parse_fingertip, unambiguous_cap
from handsight.errors import InvalidInput, InvalidTransform
from testbed.refusals import refused


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"semi_axes": [8, 8, 12]}, "semi_axes[0]"),
        ({"semi_axes": [0.008, 0.008, -1]}, "semi_axes[2]"),
        ({"semi_axes": [0.008, 0, 0.012]}, "semi_axes[1]"),
        ({"semi_axes": [0.008, np.nan, 0.01]}, "semi_axes"),
        ({"semi_axes": 0.008}, "semi_axes"),
        ({"cap": 0.012}, "cap"),
        ({"cap": -3}, "cap"),
        ({"cap": np.inf}, "cap"),
        ({"max_friction": 0}, "max_friction"),
        ({"min_force": -1}, "min_force"),
        ({"min_force": 1e-12}, "min_force"),
        ({"T_surface_sensor": np.eye(3)}, "T_surface_sensor"),
    ],
)
def test_a_wrong_ellipsoid_is_refused_by_field(arguments, field):
    with refused(InvalidInput, field):
        Ellipsoid(**{"semi_axes": (0.008, 0.008, 0.012), **arguments})


@pytest.mark.parametrize(
    ("arguments", "field"), [({"radius": 9}, "radius"), ({"radius": 0}, "radius"), ({"cap": 0.01}, "cap")]
)
def test_a_wrong_sphere_is_refused_by_field(arguments, field):
    with refused(InvalidInput, field):
        Sphere(**{"radius": 0.009, **arguments})


def test_a_sensor_s_pose_must_be_rigid():
    with refused(InvalidTransform, "T_surface_sensor"):
        Sphere(0.009, T_surface_sensor=2 * np.eye(4))


def test_the_unambiguous_cap_of_a_sphere_is_where_friction_can_point_sideways():
    # On a sphere the normal leans by the polar angle: that and the friction angle make a right angle.
    cap = unambiguous_cap(Sphere(0.01, max_friction=0.75))
    assert np.arccos(cap / 0.01) + np.arctan(0.75) == pytest.approx(np.pi / 2)
    with refused(InvalidInput, "fingertip"):
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


@pytest.mark.parametrize(
    "text",
    [
        "",
        "cube:8mm",
        "ellipsoid",
        "ellipsoid:8,8mm",
        "ellipsoid:8,x,12mm",
        "ellipsoid:8,8,12",
        "sphere:9in",
        "sphere:",
        "sphere:nanmm",
        "sphere:9m",
        "sphere:9mm;cap=9mm",
        "sphere:9mm;cap=0",
        "sphere:9mm;cap=0mm,1mm",
        "sphere:9mm;friction=1N",
        "sphere:9mm;min_force=1kg",
        "sphere:9mm;sensor=1,2mm",
        "sphere:9mm;mu=1",
        "sphere:9mm;cap=0mm;cap=1mm",
    ],
)
def test_a_fingertip_typed_wrongly_is_refused(text):
    with pytest.raises(InvalidInput):
        parse_fingertip(text)
