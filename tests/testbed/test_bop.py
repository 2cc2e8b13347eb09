"""BOP's errors of poses that are off by a known amount, against slow and plain formulas."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.objects import Symmetries
from testbed import bop
from testbed.sight_scenes import CAMERA

BOX = hs.ObjectModel.box((0.08, 0.05, 0.03))
CAN = hs.ObjectModel.cylinder(0.03, 0.1)
AT = se3.compose(se3.rotation_exp(np.array([0.5, 0.3, -0.2])), np.array([0.02, -0.01, 0.5]))


def shifted(*by):
    return se3.compose(np.eye(3), np.array(by)) @ AT


def turned(axis, angle):
    return AT @ se3.compose(se3.rotation_exp(angle * np.array(axis, dtype=float)), np.zeros(3))


@pytest.mark.parametrize("model", [BOX, CAN], ids=["box", "can"])
def test_the_truth_and_its_equivalents_have_the_full_recall(model):
    depth = bop.drawn(model, CAMERA, AT)
    equivalent = turned((0, 0, 1), 1.234 if model is CAN else np.pi)
    for T in (AT, equivalent):
        errors = bop.pose_errors(model, CAMERA, depth, AT, T)
        assert errors.recalls == (1.0, 1.0, 1.0)
        assert errors.mssd < 2e-3  # a continuous symmetry is sampled
    assert bop.mssd(model, AT, AT) == bop.mspd(model, CAMERA, AT, AT) == 0


def test_a_half_turn_is_an_error_of_an_object_that_does_not_have_it():
    plain = BOX.with_symmetries(Symmetries())
    off = turned((0, 0, 1), np.pi)
    assert bop.mssd(BOX, AT, off) < 1e-9
    assert bop.mssd(plain, AT, off) == pytest.approx(np.hypot(0.08, 0.05) / BOX.diameter)


def test_largest_distances_are_those_of_all_vertices_and_symmetries():
    rng = np.random.default_rng(3)
    K = CAMERA.matrix
    for _ in range(5):
        T = se3.moved(AT, rng.normal(size=6) * [0.01, 0.01, 0.01, 0.2, 0.2, 0.2])
        space, image = [], []
        for S in BOX.symmetries.rotations:
            true, found = (se3.apply(at, BOX.vertices) for at in (AT @ S, T))
            space.append(np.linalg.norm(true - found, axis=1).max())
            pixels = [(P[:, :2] / P[:, 2:]) * K[[0, 1], [0, 1]] for P in (true, found)]
            image.append(np.linalg.norm(pixels[0] - pixels[1], axis=1).max())
        assert bop.mssd(BOX, AT, T) == pytest.approx(min(space) / BOX.diameter)
        wide = min(image) * 640 / CAMERA.size[0]
        assert bop.mspd(BOX, CAMERA, AT, T) == pytest.approx(wide, rel=1e-9)


def test_visible_discrepancy_counts_pixels_one_by_one():
    rng = np.random.default_rng(5)
    diameter = 0.1
    measured, truth, estimate = (rng.choice([0, 0.5, 0.51, 0.53], (12, 15)) for _ in range(3))
    costs = [[] for _ in bop.SHARES]
    for m, t, e in zip(measured.ravel(), truth.ravel(), estimate.ravel(), strict=True):
        in_truth = t > 0 and (m == 0 or t - m <= 0.015)
        in_estimate = e > 0 and (m == 0 or e - m <= 0.015 or in_truth)
        if in_truth or in_estimate:
            for cost, tau in zip(costs, bop.SHARES, strict=True):
                cost.append(not (in_truth and in_estimate and abs(t - e) / diameter < tau))
    expected = [np.mean(cost) for cost in costs]
    assert bop.visible_discrepancy(measured, truth, estimate, diameter) == pytest.approx(expected)


def test_an_object_behind_a_wall_that_is_not_there_is_wrong_everywhere():
    wall = np.full(CAMERA.size[::-1], 0.3)
    off = bop.pose_errors(BOX, CAMERA, wall, AT, shifted(0.2, 0, 0))
    assert off.recalls == (0.0, 0.0, 0.0)  # nothing of it is visible: an error of 1


def test_the_recall_is_the_share_of_thresholds_above_the_error():
    errors = bop.BopErrors(vsd=np.full(10, 0.22), mssd=0.12, mspd=31.0)
    assert errors.recalls == pytest.approx((0.6, 0.8, 0.4))
