"""Arguments of Python functions: contacts, priors, points outside the object, transforms."""

import copy
import pickle
import random

import numpy as np

import handsight as hs
from handsight import se3
from handsight.correction import Outside, Plane
from handsight.objects import Symmetries
from handsight.tracking import TrackerSettings
from tests.corpus.door import Case, Door, check_covariance, check_pose, spoilt_value

BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])
GOOD: dict[str, object] = {
    "points": [[0.03, 0.0, 0.0], [-0.03, 0.01, 0.02], [0.0, 0.045, -0.03]],
    "normals": [[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]],
    "sigma_point": 0.001,
    "sigma_normal": 0.1,
    "T": np.eye(4).tolist(),
    "sigma_position": 0.02,
    "sigma_rotation": 0.2,
    "covariance": np.diag([4e-4] * 3 + [0.04] * 3).tolist(),
    "outside": [[0.05, 0.1, 0.1], [0.2, 0.0, 0.0]],
    "plane": [0.0, 0.0, -0.08],
    "plane_normal": [0.0, 0.0, 1.0],
    "plane_sigma": 0.001,
}


def correct(given: dict[str, object]) -> None:
    """Corrects a pose with these arguments; a key that is missing is an argument that is not given."""
    contacts = hs.Contacts(
        *(given.get(name) for name in ("points", "normals", "sigma_point", "sigma_normal"))
    )
    if "covariance" in given and "sigma_position" not in given:
        vision = hs.PosePrior(given.get("T"), given["covariance"])
    else:
        vision = hs.PosePrior.from_sigmas(
            *(given.get(name) for name in ("T", "sigma_position", "sigma_rotation"))
        )
    plane = Plane(*(given.get(name) for name in ("plane", "plane_normal", "plane_sigma")))
    estimate = hs.correct_pose(
        BOX, contacts, vision=vision, outside=Outside(given.get("outside", ()), [plane])
    )
    check_pose(estimate.T_palm_object)
    check_covariance(estimate.covariance)
    assert np.isfinite(estimate.information).all()
    assert np.linalg.eigvalsh(estimate.information).min() > -1e-6 * np.abs(estimate.information).max()
    assert np.isfinite(estimate.residuals.distance).all()
    assert abs(sum(h.weight for h in estimate.hypotheses) - 1) < 1e-9


def correct_spoilt(rng: random.Random) -> None:
    """Corrects a pose with one or two corrupted arguments."""
    given = dict(GOOD)
    if rng.random() < 0.5:
        del given["sigma_position"]
    for _ in range(rng.choice([1, 1, 2])):
        key = rng.choice(sorted(given))
        given[key] = spoilt_value(given[key], rng)
    correct(given)


CAMERA = hs.Camera(np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), (64, 48))
T_CAMERA_BOX = se3.compose(se3.rotation_exp(np.array([0.5, 0.4, 0])), np.array([0, 0, 0.35]))
DEPTH = CAMERA.draw(se3.apply(T_CAMERA_BOX, BOX.vertices), np.asarray(BOX.faces)).depth
DETECTED: dict[str, object] = {
    "box": [10, 5.5, 50, 43],
    "mask": np.isfinite(DEPTH).tolist(),
    "score": 0.8,
    "start": T_CAMERA_BOX.tolist(),
}


def locate(given: dict[str, object]) -> None:
    """Locates the box with what a detector says of it, and asserts that poses and judgements are ones."""
    with np.errstate(all="ignore"):
        found = hs.locate(BOX, DEPTH, CAMERA, **given)
    for T in found.Ts_camera_object:
        check_pose(T)
    assert 0 <= found.probability <= 1
    if found.starts is not None:
        for T in found.starts.Ts_camera_object:
            check_pose(T)
        assert np.isfinite(found.starts.moved).all()
        assert ((found.starts.probabilities >= 0) & (found.starts.probabilities <= 1)).all()


def locate_spoilt(rng: random.Random) -> None:
    """Locates the box with one corrupted argument, and some of the others."""
    given = {key: value for key, value in DETECTED.items() if rng.random() < 0.5}
    key = rng.choice(sorted(DETECTED))
    locate({**given, key: spoilt_value(DETECTED[key], rng)})


SPIN = Symmetries([([0, 0, 0], [0, 0, 1])])


def masked_mesh() -> None:
    """Builds an object of vertices of which some are masked."""
    hs.ObjectModel.from_mesh(np.ma.masked_less(BOX.vertices, -0.06), BOX.faces)


def copied_prior() -> None:
    """Copies of a prior have its numbers, and can be changed as little as the prior itself."""
    prior = hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)
    for each in (copy.copy(prior), copy.deepcopy(prior), pickle.loads(pickle.dumps(prior))):
        np.testing.assert_array_equal(each.T_palm_object, prior.T_palm_object)
        np.testing.assert_array_equal(each.covariance, prior.covariance)
        assert each.record == prior.record
        assert not each.T_palm_object.flags.writeable
        assert not each.covariance.flags.writeable


DOORS = [Door("correct_pose", correct_spoilt, 300), Door("locate", locate_spoilt, 200)]
CASES = [
    Case(
        "masked points",
        lambda: correct({**GOOD, "points": np.ma.masked_less(GOOD["points"], 0)}),
        "got a masked array",
    ),
    Case(
        "a mask of nothing", lambda: correct({**GOOD, "points": np.ma.masked_invalid(GOOD["points"])}), None
    ),
    Case("a masked mesh", masked_mesh, "vertices: expected numbers, got a masked array"),
    Case(
        "a turn about a box",
        lambda: BOX.with_symmetries(SPIN) and None,
        "symmetries: expected turns that leave the surface in place, got one",
    ),
    Case("a half turn of a box", lambda: BOX.with_symmetries(BOX.symmetries) and None, None),
    Case("copies of a prior", copied_prior, None),
    Case("what a detector says as it should be", lambda: locate(DETECTED), None),
    Case("a sigma of 1e155", lambda: correct({**GOOD, "sigma_point": 1e155}), "sigma_point: expected"),
    Case("a prior 1e20 away", lambda: correct({**GOOD, "T": _at(1e20)}), "vision.T_palm_object: translation"),
    Case(
        "a prior 1e160 wide", lambda: correct({**GOOD, "sigma_position": 1e160}), "sigma_position: expected"
    ),
    Case(
        "a point outside at 1e200", lambda: correct({**GOOD, "outside": [[1e200, 0, 0]]}), "outside: expected"
    ),
    Case("a billion samples", lambda: _sampled(10**9), "samples: expected a whole number from 0 to"),
    Case("samples that are no number", lambda: _sampled(object()), "got <object object>"),
    Case(
        "a billion samples of a tracker",
        lambda: TrackerSettings(samples=10**9),
        "samples: expected a whole number",
    ),
    Case(
        "a billion points of a hand",
        lambda: TrackerSettings(outside=10**9),
        "outside: expected a whole number",
    ),
    Case("a plane known to 1e-12", lambda: correct({**GOOD, "plane_sigma": 1e-12}), "plane.sigma: expected"),
]


def _sampled(count: object) -> None:
    hs.correct_pose(BOX, hs.Contacts([[0.03, 0, 0]]), samples=count)


def _at(x: float) -> list[list[float]]:
    T = np.eye(4)
    T[0, 3] = x
    return T.tolist()
