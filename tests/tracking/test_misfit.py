"""What contradicts the model for a while is named, and inflates the answer."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import Conflict, PoseEstimate, PosePrior
from handsight.tracking.misfit import NOISE_FREEDOM, TOUCH, WINDOW, Innovations, Misfit


def test_a_step_of_many_sigma_is_named_inflates_and_fades():
    model = hs.ObjectModel.box([0.1, 0.06, 0.04])
    old = PoseEstimate.from_gaussian(np.eye(4), 1e-6 * np.eye(6), np.empty((0, 6)))
    far = se3.moved(np.eye(4), np.array([0.055, 0, 0, 0, 0, 0]))
    new = PoseEstimate.from_gaussian(far, 1e-6 * np.eye(6), np.empty((0, 6)))
    watched = Innovations().moved(0.02, model, old, new, np.zeros(6))
    assert str(watched.worst) == "the answer has moved by 39 sigma at once"
    step = se3.difference(new.T_palm_object, old.T_palm_object)
    covariance = watched.inflated(new).covariance
    assert (
        6 < step @ np.linalg.solve(covariance, step) < 22.5
    )  # 99.9 % of six numbers: the old answer is possible
    later = watched.moved(10 * WINDOW, model, new, new, np.zeros(6))
    assert later.worst is None
    assert later.inflated(new) is new


def test_a_finger_is_named_once_it_was_rejected_for_most_of_a_second():
    finger = Misfit("ff", expected=3)
    states = []
    for _ in range(50):
        finger = finger.after(1 - np.exp(-0.02 / WINDOW), 100.0, 3, 1.0)
        states.append(bool(finger.contradicts))
    assert states[0] is False
    assert states[-1] is True
    assert 25 < states.index(True) < 40
    assert str(finger) == "finger ff contradicts the others"


def test_a_weight_that_contradicts_for_long_is_named_inflates_does_not_flicker_and_fades():
    fits = PoseEstimate.from_gaussian(np.eye(4), 1e-6 * np.eye(6), 1e6 * np.eye(6))
    prior = PosePrior(np.eye(4), 1e-2 * np.eye(6))
    conflict = Conflict("weight", "contacts", 60.0, 3, 1e-9, np.zeros(6), excluded=True)
    wrong = replace(fits, weight_fits=False, conflicts=(conflict,))
    watched, named = Innovations(), []
    # It contradicts for two seconds, but for one correction of ten; then it fits.
    for k in range(200):
        now = wrong if k < 100 and k % 10 else replace(fits, weight_fits=True)
        watched = watched.after(0.02, (), now, prior)
        named.append(watched.worst is not None)
        if k == 99:
            assert str(watched.worst) == "the weight has contradicted the rest by 7 sigma"
            inflated = watched.inflated(fits).covariance
    assert not named[0]
    assert named[99]
    assert not named[-1]
    assert sum(a != b for a, b in itertools.pairwise(named)) == 2
    assert 5e-6 < inflated[0, 0] < 1e-5


def test_evidence_that_fits_is_not_named_and_leaves_the_answer_as_it_is():
    fits = Misfit("vision", nis=6.0, expected=6.0)
    assert not fits.contradicts
    assert fits.factor == 1


def test_the_region_holds_where_the_declared_sigma_of_touch_is_an_estimate_of_four_degrees_of_freedom():
    """And it changes nothing of what the prior alone tells, nor a direction of symmetry."""
    model, rng = hs.ObjectModel.box([0.1, 0.06, 0.04]), np.random.default_rng(0)
    prior = PosePrior(np.eye(4), np.diag([1e-4, 1e-6, 1e-4, 1e-2, 1e-2, 1e-4]))
    by_touch = np.diag([1e6, 1e2, 1e6, 1e6 * model.radius**2, 1e6 * model.radius**2, 0.0])
    information = np.linalg.inv(prior.covariance) + by_touch
    estimate = PoseEstimate.from_gaussian(np.eye(4), np.linalg.inv(information), np.empty((0, 6)))
    watched = Innovations({TOUCH: Misfit(TOUCH, nis=9.0, expected=15.0)})
    covered = watched.covered(model, estimate, prior)
    np.testing.assert_allclose(covered.covariance @ covered.information, np.eye(6), atol=1e-6)
    assert covered.covariance[5, 5] == pytest.approx(1e-4)
    assert 1e-6 * 0.98 < covered.covariance[1, 1] < 1e-6
    true_sigma = np.sqrt(NOISE_FREEDOM / rng.chisquare(NOISE_FREEDOM, 4000))
    noise = rng.normal(size=(4000, 6)) * np.sqrt(np.diag(estimate.covariance))
    noise[:, [0, 2, 3, 4]] *= true_sigma[:, None]
    squares = np.einsum("ni,ij,nj->n", noise, covered.information, noise)
    assert 0.94 < (squares < 12.592).mean() < 0.98
    misfits = Innovations({TOUCH: Misfit(TOUCH, nis=72.0, expected=15.0)})
    ratio = misfits.covered(model, estimate, prior).covariance[0, 0] / covered.covariance[0, 0]
    assert ratio == pytest.approx(4.0, rel=0.1)  # (4 + 72) / (4 + 15)
    spin = np.diag([1.0, 1, 1, 1, 1, 0]) @ information
    free = estimate.with_gaussian(np.eye(4), None, spin)
    assert not watched.covered(model, free, prior).information[5].any()
