"""Patches of taxels on curved tips are contacts: where, with which normal and force, and how certain. Synthetic tips."""

import numpy as np
import pytest

from handsight import se3
from handsight.contact import TactileSurface
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from testbed import skin_scenes
from testbed.refusals import refused
from testbed.skin_scenes import HELD_OUT, SHAPES, errors, pressed, tip

BALL = SHAPES["ball"]


def strongest(touch):
    return touch.patches[touch.strongest]


def judged(components, count=120, seed=77):
    """Errors of the point [mm], the normal [deg] and the force [share], and the squared deviation per freedom."""
    rows = []
    for name in HELD_OUT:
        for k in range(count):
            rng = np.random.default_rng([seed, k, len(name)])
            if k % 10 == 0:
                surface = tip(SHAPES[name], rng, components=components)
            truth = pressed(SHAPES[name], surface, rng)
            rows.append(list(errors(strongest(surface.touch(truth.readings)), truth).values()))
    return np.array(rows).T


def test_a_three_axis_tip_senses_point_normal_and_force_as_well_as_it_says():
    """30 taxels, 4.7 mm apart, 5 % noise, a dead one; shapes and seeds on which no constant was chosen."""
    point, normal, force, squared = judged(3)
    assert np.median(point) < 0.8
    assert np.median(normal) < 6
    assert np.median(force) < 0.08
    # Nothing says how soft the tip is, so the contact's height is less certain than where it touches first.
    assert 0.5 < squared.mean() < 1.3


def test_a_contact_across_the_edge_of_a_layout_is_beyond_it_and_as_uncertain_as_it_says():
    """Up to 9 mm from the taxels, on shapes and seeds on which no constant was chosen. In the mean NEES is within twice of
    what covariances say; some contacts far beyond the edge are overconfident."""
    felt, found, squared = [], [], []
    for k in range(1600):
        rng = np.random.default_rng([31, k])
        shape = SHAPES[HELD_OUT[k // 20 % 2]]
        if k % 20 == 0:
            surface = tip(shape, rng)
        place = rng.normal(size=3)
        place *= shape.axes / np.linalg.norm(place)
        if not 2e-3 < np.linalg.norm(surface.points - place, axis=1).min() < 9e-3:
            continue
        truth = pressed(shape, surface, rng, place=place, dead=0)
        touch = surface.touch(truth.readings)
        if not len(touch.patches):
            continue
        patch, mine = strongest(touch), touch.states[1, :-1] == touch.strongest
        share = np.where(mine, touch.rise[:-1, 2].clip(0), 0)
        edge = np.linalg.norm(share @ surface.taxels["edge"]) / share.sum()
        if edge > 0.45:
            felt.append(np.linalg.norm(share @ surface.points / share.sum() - truth.point))
            found.append(np.linalg.norm(patch["point"] - truth.point))
            squared.append(errors(patch, truth)["nees"])
    assert len(found) > 200
    assert np.mean(found) < 0.7 * np.mean(felt)
    assert np.median(squared) < 1
    assert 0.7 < np.mean(squared) < 2


def test_a_shear_in_proportion_to_the_pressure_moves_neither_centre_nor_normal_of_a_patch():
    """Taxels that face a shear read more along their normals, but bear no more of the load."""
    surface = tip(BALL, np.random.default_rng(3), taxels=60, pitch=0.0028)
    r2 = (surface.points[:, :2] ** 2).sum(axis=1)
    pressure = np.where(surface.points[:, 2] > 0, np.maximum(1 - r2 / 0.005**2, 0), 0)
    found = []
    for shear in ([0.0, 0.0], [0.6, 0.0], [-0.3, 0.5]):
        forces = pressure[:, None] * [*shear, -1.0]
        own = np.einsum("nik,ni->nk", surface.taxels["axes"], forces) * [1, 1, -1]
        found.append(strongest(surface.touch(own)))
        np.testing.assert_allclose(found[-1]["point"], found[0]["point"], atol=2e-5)
        np.testing.assert_allclose(found[-1]["normal"], found[0]["normal"], atol=2e-3)


def test_a_patch_has_the_torsion_about_its_normal():
    errors, sizes = [], []
    for k in range(60):
        rng = np.random.default_rng([5, k])
        surface = tip(BALL, rng)
        truth = pressed(BALL, surface, rng, dead=0)
        errors.append(strongest(surface.touch(truth.readings))["torque"] - truth.torque)
        sizes.append(truth.torque)
    assert np.std(errors) < 0.5 * np.std(sizes)


def test_the_centre_of_an_even_patch_is_on_the_surface_with_the_surfaces_normal():
    """Without noise: on a sphere the raised chord is on the sphere."""
    surface = tip(BALL, np.random.default_rng(1))
    for middle in range(8):
        distance = np.linalg.norm(surface.points - surface.points[middle], axis=1)
        readings = np.zeros(surface.shape)
        readings[:, 2] = np.maximum(1 - (distance / 0.007) ** 2, 0)
        patch = strongest(surface.touch(readings))
        assert np.linalg.norm(patch["point"]) == pytest.approx(0.013, rel=4e-3)
        np.testing.assert_allclose(patch["normal"], -patch["point"] / 0.013, atol=0.03)


def test_two_patches_on_a_tip_are_two_contacts_of_full_covariance():
    rng = np.random.default_rng(3)
    surface = tip(BALL, rng, taxels=60)
    ends = surface.points[:, 1].argmin(), surface.points[:, 1].argmax()
    readings = sum(
        pressed(BALL, surface, rng, force=1.0, dead=0, place=surface.points[i] * [1, 0.8, 1]).readings
        for i in ends
    )
    touch = surface.touch(readings)
    assert len(touch.patches) == 2
    by_error = np.zeros((6, 1))
    by_error[3] = 0.1  # a turn about x
    T = se3.random(rng, spread=0.1)
    fixed, moving = touch.contacts(T), touch.contacts(T, by_error)
    assert len(fixed) == 2
    assert (np.linalg.eigvalsh(fixed.covariance[:, :3, :3]) > 0.5 * surface.sigma_mount**2).all()
    for i in range(2):
        arm = fixed.points_palm[i] - T[:3, 3]
        turned = np.concatenate([np.cross([0.1, 0, 0], arm), np.cross([0.1, 0, 0], fixed.normals_palm[i])])
        added = moving.covariance[i] - fixed.covariance[i]
        np.testing.assert_allclose(added, np.outer(turned, turned), atol=1e-12)
    kept = touch.contacts(T, without=touch.strongest)
    assert len(kept) == 1


def test_untouched_taxels_of_a_tip_are_evidence_beside_the_patch_only():
    rng = np.random.default_rng(6)
    surface = tip(BALL, rng, taxels=60)
    touch = surface.touch(pressed(BALL, surface, rng, force=1.0, dead=0, place=surface.points[0]).readings)
    patch, points = strongest(touch), touch.outside(np.eye(4))
    assert 0 < len(points) < touch.untouched.sum()
    distance = np.linalg.norm(points - patch["point"], axis=1)
    assert distance.min() > surface.pitch
    assert distance.max() < 5 * surface.pitch
    evidence = SkinEvidence.of(touch, np.eye(4))
    assert (evidence.sigmas == 0).all()  # a patch's covariance has the mount's error in it


def test_a_dead_taxel_amid_a_patch_hardly_moves_its_centre():
    rng = np.random.default_rng(8)
    surface = tip(BALL, rng)
    for _ in range(20):
        truth = pressed(BALL, surface, rng, force=3.0, dead=0)
        whole = strongest(surface.touch(truth.readings))
        missing = truth.readings.copy()
        missing[missing[:, 2].argmax()] = np.nan
        patch = strongest(surface.touch(missing))
        assert np.linalg.norm(patch["point"] - whole["point"]) < 1.5e-3
        assert np.linalg.norm(patch["force"] - whole["force"]) < 0.35 * np.linalg.norm(whole["force"])


FIELDS = {
    "frame": "tip",
    "points": BALL.axes[0] * np.eye(3),
    "normals": np.eye(3),
    "threshold": 0.1,
    "pitch": 0.02,
}


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"points": np.eye(3)}, 'points'),
        ({"pitch": 4.7}, 'pitch'),
        ({"normals": np.eye(3)[:2]}, 'normals'),
        ({"normals": -np.eye(3)}, 'normals'),
        ({"points": np.zeros((3, 3))}, 'points[0]'),
        ({"components": 2}, 'components'),
        ({"scale": [1.0, 1.0]}, 'scale'),
        ({"scale": 0.0}, "scale, noise"),
        ({"x_axes": np.eye(3)}, 'x_axes[0]'),
    ],
)  # fmt: skip
def test_a_wrong_surface_is_refused(given, field):
    with refused(InvalidInput, field):
        TactileSurface(**FIELDS | given)


@pytest.mark.parametrize("declared", [None, 0.5, 1.0, 2.0])
def test_a_contact_of_soft_skin_is_where_the_object_has_sunk_to(declared):
    """By a stiffness that is right, wrong by a factor of two, or unknown, the true surface is within its sigma."""
    springs, heights, squares = 6e7, [], []
    stiffness = None if declared is None else declared * springs
    for seed in range(25):
        rng = np.random.default_rng(seed)
        shape = skin_scenes.SHAPES["egg"]
        surface = skin_scenes.tip(shape, rng, stiffness=stiffness)
        truth = skin_scenes.pressed(shape, surface, rng, springs=springs, force=2.0)
        touch = surface.touch(truth.readings)
        height, squared = skin_scenes.height_error(strongest(touch), truth)
        heights.append(abs(height))
        squares.append(squared)
    assert np.median(heights) < {None: 1.5, 0.5: 0.6, 1.0: 0.25, 2.0: 0.6}[declared]
    assert np.mean(squares) < (5 if declared == 2.0 else 2)
