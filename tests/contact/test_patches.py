"""Patches of taxels on curved tips are contacts: where, with which normal and force, and how certain. Synthetic tips."""

from dataclasses import replace

import numpy as np
import pytest

import tip_scenes
from handsight import se3
from handsight.contact import TactileSurface
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from tip_scenes import HELD_OUT, SHAPES, errors, pressed, tip

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
    assert 0.7 < squared.mean() < 1.3


def test_a_tip_of_one_component_senses_the_point_too():
    point, normal, force, _ = judged(1)
    assert np.median(point) < 1.2
    assert np.median(normal) < 6
    assert np.isnan(force).all()


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


def test_a_scaled_reading_gives_scaled_forces_and_the_same_place():
    rng = np.random.default_rng(2)
    surface = tip(BALL, rng)
    truth = pressed(BALL, surface, rng, dead=0)
    counts = replace(surface, scale=[0.01, 0.01, -0.01], offset=[0, 0, 2135.0])
    raw = truth.readings * [100, 100, -100] + [0, 0, 2135.0]
    one, other = strongest(surface.touch(truth.readings)), strongest(counts.touch(raw))
    for name in ("point", "normal", "force", "covariance"):
        np.testing.assert_allclose(other[name], one[name], atol=1e-9)


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


def test_a_wide_patch_says_less_of_its_normal():
    surface = tip(BALL, np.random.default_rng(4))
    sigmas = []
    for width in (0.006, 0.012):
        readings = np.zeros(surface.shape)
        distance = np.linalg.norm(surface.points - surface.points[0], axis=1)
        readings[:, 2] = np.maximum(1 - (distance / width) ** 2, 0)
        sigmas.append(np.trace(strongest(surface.touch(readings))["covariance"][3:, 3:]))
    assert sigmas[1] > 1.5 * sigmas[0]


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
    ("given", "message"),
    [
        ({"points": np.eye(3)}, r"points: expected metres, within 0.5 m, got 1 \(millimetres\?\)"),
        ({"pitch": 4.7}, "pitch: expected metres from 0.0002 to 0.05, got 4.7"),
        ({"normals": np.eye(3)[:2]}, r"normals: expected finite numbers of shape \(3, 3\)"),
        ({"normals": -np.eye(3)}, "normals: expected normals that point out of the link, got normals that point into"),
        ({"points": np.zeros((3, 3))}, r"points\[0\]: expected a place of its own"),
        ({"components": 2}, "components: expected 1 or 3, got 2"),
        ({"scale": [1.0, 1.0]}, "scale: expected 1 finite numbers"),
        ({"scale": 0.0}, "scale, noise: expected no 0"),
        ({"x_axes": np.eye(3)}, r"x_axes\[0\]: expected a direction across the normal"),
    ],
)  # fmt: skip
def test_a_wrong_surface_is_refused(given, message):
    with pytest.raises(InvalidInput, match=message):
        TactileSurface(**FIELDS | given)


@pytest.mark.parametrize("reading", [np.zeros(30), np.zeros((30, 2)), np.zeros((29, 3)), "much"])
def test_a_reading_of_another_number_of_taxels_is_refused(reading):
    with pytest.raises(InvalidInput, match="reading: expected 30 times 3 numbers, got"):
        tip(BALL, np.random.default_rng(0)).touch(reading)


def test_the_simulated_press_has_its_force_and_its_centre():
    rng = np.random.default_rng(9)
    surface = tip(BALL, rng, taxels=90, pitch=0.003)
    truth = pressed(BALL, surface, rng, force=2.0, round_by=0.0, dead=0, place=surface.points[0])
    assert truth.force @ truth.normal == pytest.approx(2.0, rel=0.03)
    assert np.linalg.norm(np.cross(truth.center - truth.point, truth.normal)) < 6e-4
    assert np.linalg.norm(np.cross(truth.force, truth.normal)) / 2.0 < tip_scenes.FRICTION * 1.2
