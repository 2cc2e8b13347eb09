"""Symmetries of `models_info.json` are read as the groups they mean, however they are rounded."""

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel, Symmetries, about
from handsight.objects.library.documents import ContinuousAxis, Info, info_of, symmetries_of
from testbed.refusals import refused

X, Y, Z = np.eye(3)
GROUPS = {
    "half turn": [np.pi * Z],
    "third": [2 * np.pi / 3 * Z],
    "box": [np.pi * X, np.pi * Y],
    "cube": [np.pi / 2 * Z, np.pi / 2 * X],
    "icosahedron": [2 * np.pi / 3 * np.array([1, 1, 1]) / np.sqrt(3), np.pi * Z,
                    2 * np.pi / 5 * np.array([0, 1, (1 + np.sqrt(5)) / 2]) / np.linalg.norm([0, 1, (1 + np.sqrt(5)) / 2])],
    "prism of 30": [2 * np.pi / 30 * Z, np.pi * X],
}  # fmt: skip


def flat(T, digits):
    """The transform as a file has it, in millimetres with so many decimals."""
    return tuple(np.round(se3.compose(T[:3, :3], 1e3 * T[:3, 3]), digits).reshape(-1).tolist())


def farthest(of, expected):
    """The largest distance of a rotation of one group from the nearest of the other."""
    return max(np.abs(of.rotations - T).max(axis=(1, 2)).min() for T in expected.rotations)


@pytest.mark.parametrize("digits", [3, 4, 6, 15])
@pytest.mark.parametrize("name", GROUPS)
def test_a_group_of_few_digits_is_read_as_an_exact_group(name, digits, rng):
    turned = se3.rotation_exp(rng.normal(size=3))
    made = Symmetries(rotations=about(rng.normal(size=3) * 0.02, np.array(GROUPS[name]) @ turned.T))
    info = Info(diameter=200.0, symmetries_discrete=[flat(T, digits) for T in made.rotations[1:]])
    found = symmetries_of(info)
    assert len(found.rotations) == len(made.rotations)
    # A decimal of a millimetre is a smaller error than the same decimal of a sine.
    assert farthest(found, made) < 3 * 10.0**-digits
    for one in found.rotations[1:4]:  # closed and rigid to rounding
        for other in found.rotations[:4]:
            assert np.abs(found.rotations - one @ other).max(axis=(1, 2)).min() < 1e-12


def test_turns_that_generate_a_group_are_read_as_all_of_it():
    info = Info(
        diameter=200.0,
        symmetries_discrete=[flat(se3.compose(se3.rotation_exp(v), np.zeros(3)), 4) for v in GROUPS["cube"]],
    )
    assert len(symmetries_of(info).rotations) == 24


@pytest.mark.parametrize("make", [ObjectModel.box, ObjectModel.cylinder, ObjectModel.sphere])
def test_the_written_symmetries_of_an_object_are_read_back(make, rng):
    model = make(*{"box": ([0.06, 0.06, 0.14],), "cylinder": (0.03, 0.1), "sphere": (0.04,)}[make.__name__])
    written = info_of(model)
    info = Info(
        diameter=written["diameter"],
        symmetries_discrete=[tuple(row) for row in written["symmetries_discrete"]],
        symmetries_continuous=[
            ContinuousAxis(axis=tuple(line["axis"]), offset=tuple(line["offset"]))
            for line in written["symmetries_continuous"]
        ],
    )
    found = symmetries_of(info)
    assert len(found.axes) == len(model.symmetries.axes)
    assert found.round == model.symmetries.round
    for (point, axis), (other, along) in zip(found.axes, model.symmetries.axes, strict=True):
        np.testing.assert_allclose(point, other, atol=1e-12)
        np.testing.assert_allclose(np.abs(axis @ along), 1, atol=1e-12)
    assert len(found.rotations) == (1 if found.round else len(model.symmetries.rotations))
    if not found.axes:
        assert farthest(found, model.symmetries) < 1e-12


def test_any_half_turn_that_swaps_the_ends_of_an_axis_is_read_as_one_about_their_middle(rng):
    for _ in range(20):
        axis, point = rng.normal(size=3), rng.normal(size=3) * 0.05
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, rng.normal(size=3))
        flip = about(point, np.pi * side / np.linalg.norm(side)) @ about(point, rng.uniform(0, 6) * axis)
        off = point + rng.normal() * 0.1 * axis  # any point of the axis
        info = Info(
            diameter=200.0,
            symmetries_discrete=[flat(flip, 4), flat(about(point, 0.3 * axis), 4)],
            symmetries_continuous=[ContinuousAxis(axis=tuple(axis), offset=tuple(1e3 * off))],
        )
        found = symmetries_of(info)
        assert len(found.rotations) == 2
        moved = found.rotations[1]
        np.testing.assert_allclose(moved @ moved, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(se3.apply(moved, point[None])[0], point, atol=1e-3)


def test_two_axes_that_cross_are_read_as_a_ball():
    axes = [ContinuousAxis(axis=(0, 0, 1.0), offset=(5.0, 0, 0)), ContinuousAxis(axis=(1.0, 0, 0))]
    assert symmetries_of(Info(diameter=80.0, symmetries_continuous=axes)).round


SHIFT = (1.0, 0, 0, 30, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
ALONG_Z = (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 30, 0, 0, 0, 1)
QUARTER_ABOUT_X = (1.0, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)
MIRROR = (-1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
HALF = (-1.0, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
HALF_ELSEWHERE = (-1.0, 0, 0, 30, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
AXIS = [ContinuousAxis(axis=(0, 0, 1.0))]


@pytest.mark.parametrize(
    ("discrete", "continuous", "field"),
    [
        ([MIRROR], [], 'symmetries_discrete[0]'),
        ([HALF, (2.0, *HALF[1:])], [], 'symmetries_discrete[1]'),
        ([(*HALF[:15], 2.0)], [], 'symmetries_discrete[0]'),
        ([(*HALF[:3], 1e30, *HALF[4:])], [], 'symmetries_discrete[0]'),
        ([SHIFT], [], 'symmetries_discrete'),
        ([HALF, HALF_ELSEWHERE], [], 'symmetries_discrete'),
        ([flat(about(np.zeros(3), Z), 6)], [], 'symmetries_discrete'),
        ([HALF] * 121, [], 'symmetries_discrete'),
        ([SHIFT], AXIS, 'symmetries_discrete[0]'),
        ([QUARTER_ABOUT_X], AXIS, 'symmetries_discrete[0]'),
        ([ALONG_Z], AXIS, 'symmetries_discrete[0]'),
        ([], [ContinuousAxis(axis=(0, 0, 0.0))], 'axes[0].direction'),
        ([], [ContinuousAxis(axis=(0, 0, 1.0), offset=(1e300, 0, 0))], 'symmetries_continuous[0].offset'),
        ([], [*AXIS, ContinuousAxis(axis=(0, 0, 1.0), offset=(9, 0, 0))], 'axes'),
    ],
)  # fmt: skip
def test_entries_that_are_no_symmetry_group_are_refused(discrete, continuous, field):
    with refused(InvalidInput, field):
        symmetries_of(Info(diameter=100.0, symmetries_discrete=discrete, symmetries_continuous=continuous))
