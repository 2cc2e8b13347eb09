"""Corrections at the limits of valid input: sigmas, sizes and distances far from those of a hand."""

import random
import warnings
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.correction import (
    ANSWERS,
    METHODS,
    MOST_CONTACTS,
    Outside,
    PaperMethod,
    Plane,
    PoseEstimate,
    TwoPhase,
    refine_pose,
)
from tests.corpus.door import Case, Door, check_covariance, check_pose, spoilt_value

BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # that these are no objects for a hand
    MODELS = [
        BOX,
        hs.ObjectModel.box([0.001, 0.001, 0.002]),
        hs.ObjectModel.box([10.0, 6.0, 8.0]),
        hs.ObjectModel.cylinder(0.033, 0.115),
        hs.ObjectModel.cylinder(1e-3, 10.0),
        hs.ObjectModel.sphere(0.04),
    ]
SIGMAS = [1e-9, 1e-6, 1e-3, 1e-3, 0.1, 1.0, 1e3]


def extreme(rng: random.Random) -> None:
    """Corrects a pose with valid numbers, each as small or as large as is allowed."""
    draw = np.random.default_rng(rng.getrandbits(32))
    model, n = rng.choice(MODELS), rng.choice([1, 2, 3, 5])
    points, normals = model.sample(n, seed=rng.getrandbits(16))
    points = points.copy()
    points[rng.randrange(n)] = points[0]
    if rng.random() < 0.2:
        points[:], normals = points[0], np.tile(normals[0], (n, 1))
    points = np.clip(points + rng.choice([0.0, 1e-4, 0.05, 1.0]) * draw.normal(size=(n, 3)), -5, 5)
    given = normals if rng.random() < 0.6 else [v if rng.random() < 0.5 else None for v in normals]
    if rng.random() < 0.3:
        contacts = hs.Contacts(points, given, covariance=[_covariance(rng, draw) for _ in range(n)])
    else:
        contacts = hs.Contacts(points, given, rng.choice(SIGMAS), [rng.choice(SIGMAS) for _ in range(n)])
    vision = None if rng.random() < 0.1 else hs.PosePrior(_pose(rng, draw), _covariance(rng, draw))
    _solved(model, contacts, vision, rng)


def _solved(
    model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior | None, rng: random.Random
) -> None:
    """Solves the problem by one of the public functions."""
    n = len(contacts)
    outside = None
    if rng.random() < 0.3:
        plane = Plane(rng.choice([[0, 0, -0.08], [1e3, 0, 0]]), [0, 0.1, 1], rng.choice(SIGMAS))
        outside = Outside([[rng.choice([0.0, 0.05, 1e3])] * 3] * 2, [plane])
    if vision is not None and rng.random() < 0.2:
        answers = hs.correct_poses(model, [(contacts, vision)] * 2)
        check_estimate(answers[0], n)
    elif vision is not None and outside is None and rng.random() < 0.2:
        near = refine_pose(model, contacts, vision, vision.T_palm_object)
        if near is not None:
            check_estimate(near, n)
    else:
        method = rng.choice([*METHODS, "handsight", "handsight", "handsight"])
        samples = rng.choice([0, 0, 0, 20]) if method == "handsight" else 0
        answer = rng.choice(ANSWERS)
        given = {"vision": vision, "outside": outside, "answer": answer, "samples": samples, "method": method}
        check_estimate(hs.correct_pose(model, contacts, **given), n)


def check_estimate(estimate: PoseEstimate, n: int) -> None:
    """Asserts finite rigid poses, positive semidefinite covariances, and probabilities that sum to one."""
    check_pose(estimate.T_palm_object)
    check_covariance(estimate.covariance)
    assert estimate.residuals.distance.shape == (n,)
    assert np.isfinite(estimate.residuals.distance).all()
    assert np.isfinite(estimate.unobservable).all()
    for mode in estimate.hypotheses:
        check_pose(mode.T_palm_object)
        check_covariance(mode.covariance)
        assert np.isfinite([mode.weight, mode.cost]).all(), f"weight {mode.weight}, cost {mode.cost}"
        assert np.isfinite(mode.information).all()
        deviation = np.sqrt(np.maximum(np.diag(mode.information), 1e-300))
        assert np.linalg.eigvalsh(mode.information / deviation / deviation[:, None]).min() > -1e-6
    assert abs(sum(mode.weight for mode in estimate.hypotheses) - 1) < 1e-9


def _pose(rng: random.Random, draw: np.random.Generator) -> np.ndarray:
    T = se3.random(draw, spread=0.02) if rng.random() < 0.5 else np.eye(4)
    T[:3, 3] += rng.choice([0.0, 0.0, 0.01, 10.0, 999.0])
    return T


def _covariance(rng: random.Random, draw: np.random.Generator) -> np.ndarray:
    """Returns a valid covariance (6, 6): of zeros, of any sigmas, or singular."""
    scale = np.repeat([rng.choice(SIGMAS), rng.choice([0.0, *SIGMAS])], 3)
    spread = draw.normal(size=(6, rng.choice([1, 3, 6])))
    if rng.random() < 0.5:
        spread = np.eye(6)
    spread = scale[:, None] * spread / np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-12)
    return spread @ spread.T * rng.choice([0.0, 1.0, 1.0, 1.0])


def options(rng: random.Random) -> None:
    """Calls corrections with a corrupted option, batch or start."""
    contacts = hs.Contacts([[0.03, 0, 0.01], [-0.03, 0.01, 0]], [[1.0, 0, 0], [-1, 0, 0]])
    vision = hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)

    def strange(value: object) -> Any:
        return value if rng.random() < 0.8 else spoilt_value(value, rng)

    door = rng.randrange(3)
    if door == 0:
        check_estimate(hs.correct_pose(BOX, contacts, vision=vision, method=TwoPhase(strange(3))), 2)
    elif door == 1:
        usual = {
            "w_n": 0.1,
            "cloud_size": 300,
            "epsilon": 0.02,
            "min_points": 50,
            "step": 1e-3,
            "damping": 0.01,
        }
        usual |= {"max_iterations": 20, "tolerance": 1e-4, "patience": 5}
        method = PaperMethod(**{name: strange(value) for name, value in usual.items()})
        check_estimate(hs.correct_pose(BOX, contacts, vision=vision, method=method), 2)
    else:
        problem = {
            "contacts": contacts,
            "vision": vision,
            "answer": strange("best"),
            "samples": strange(0),
            "budget": strange(1.0),
            "method": strange("handsight"),
        }
        hs.correct_poses(BOX, strange([(contacts, vision), problem, (contacts, vision)]))


def many(n: int) -> hs.Contacts:
    """Returns n contacts on the box."""
    return hs.Contacts(*BOX.sample(n))


NEAR = hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)
TOO_MANY = f"contacts: expected at most {MOST_CONTACTS} contacts, got {MOST_CONTACTS + 1}"
DOORS = [Door("corrections at their limits", extreme, 150), Door("options of a correction", options, 200)]
CASES = [
    Case("500 contacts and vision", lambda: _of(500, NEAR), None),
    Case("300 contacts, blind", lambda: _of(300, None), None),
    Case("too many in a batch", lambda: _batch(MOST_CONTACTS + 1), f"problems[1].{TOO_MANY}"),
    Case("too many near a pose", lambda: _near(MOST_CONTACTS + 1), TOO_MANY),
    Case("as many contacts as may be", lambda: _of(MOST_CONTACTS, NEAR), None),
    Case("a cloud outside", lambda: _outside(np.ones((20_000, 3))), "outside: expected at most 10000 points"),
]


def _of(n: int, vision: hs.PosePrior | None) -> None:
    check_estimate(hs.correct_pose(BOX, many(n), vision=vision), n)


def _batch(n: int) -> None:
    hs.correct_poses(BOX, [(many(3), NEAR), (many(n), NEAR)])


def _near(n: int) -> None:
    refine_pose(BOX, many(n), NEAR, np.eye(4))


def _outside(points: np.ndarray) -> None:
    hs.correct_pose(BOX, many(3), vision=NEAR, outside=points)
