"""What every peer is given and how every answer is judged.

Problems are those of experiments/touch/convergence.py: a can and a box, five contacts with 0.5 mm and 2 degrees of
noise, vision off by a Gaussian draw. A peer may build what it likes from the object beforehand (`prepare`, not timed)
and may turn a problem's contacts into its own data type (`ready`, not timed either: handsight's `Contacts` exist by
then, too); timed is the call that `ready` answers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

import handsight as hs
from handsight import se3
from testbed import scenes

NEAR, FAR = scenes.VISION_ERRORS
OBJECTS = tuple(scenes.OBJECTS)
REPORTED_ON = 0
"""Seed of the problems; settings of the peers were chosen on another."""
SHIFT_LIMIT, TURN_LIMIT = 5e-3, np.deg2rad(8)
OPEN = 1 / 3
"""Contacts leave a direction open when its standard deviation is above this part of the object's radius."""

Solve = Callable[[], Any]
"""One solve of one problem; its answer is the argument of `pose_of`."""


class Peer(Protocol):
    """One way to solve a correction problem."""

    name: str
    """Name in tables."""
    uses_normals: bool
    """Whether it uses the contacts' normals."""
    uses_prior: bool
    """Whether vision is evidence; otherwise it is only an initial guess."""

    def prepare(self, model: hs.ObjectModel) -> None:
        """Prepares an object, once and not timed."""
        ...

    def ready(self, problem: "Problem") -> Solve:
        """Returns the call to time, for the object that was prepared last."""
        ...


@dataclass(frozen=True)
class Problem:
    """One grasp with its truth."""

    object_name: str
    model: hs.ObjectModel
    scene: scenes.Scene
    outside: np.ndarray | None = None
    """(m, 3) points of the hand [m], or None."""

    @property
    def contacts(self) -> hs.Contacts:
        """The contacts."""
        return self.scene.contacts

    @property
    def vision(self) -> hs.PosePrior:
        """Vision's pose."""
        return self.scene.vision


@dataclass(frozen=True)
class Verdict:
    """The error of an answer, modulo symmetry, in the directions that contacts observe."""

    shift: float
    """[m]"""
    turn: float
    """[rad]"""

    @property
    def found(self) -> bool:
        """Whether the answer is right, by the experiments' criterion."""
        return bool(self.shift < SHIFT_LIMIT and self.turn < TURN_LIMIT)


def models() -> dict[str, hs.ObjectModel]:
    """Returns the models of can and box."""
    return {name: make() for name, (make, _) in scenes.OBJECTS.items()}


def draw(object_name: str, error: str, trial: int, seed: int = REPORTED_ON, contacts: int = 5) -> Problem:
    """Returns problem `trial` of a seed; can and box at 20 and 85 mm are those of experiments/touch/convergence.py."""
    o, e = OBJECTS.index(object_name), list(scenes.VISION_ERRORS).index(error)
    rng = np.random.default_rng([seed, o, e, trial])
    make, touch = scenes.OBJECTS[object_name]
    scene = scenes.random_scene(touch(rng, contacts), rng, error=scenes.VISION_ERRORS[error])
    return Problem(object_name, make(), scene)


def pose_of(answer: Any) -> np.ndarray | None:
    """`T_palm_object` (4, 4): the answer, or its first 12 numbers, rotation row by row and position. None: None."""
    if answer is None or answer.shape == (4, 4):
        return answer
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = answer[:9].reshape(3, 3), answer[9:12]
    return T


def judged(problem: Problem, T_hat: np.ndarray) -> Verdict:
    """The same judge for everyone, whatever a peer says of its own uncertainty.

    As `scenes.pose_errors`, but what the contacts leave open is taken from the true contacts on the object and
    carried along with the answer, because a peer does not report it.
    """
    model = problem.model
    if not np.isfinite(T_hat).all():
        return Verdict(np.inf, np.inf)
    truth = scenes.nearest_truth(model, problem.scene.T_palm_object, T_hat)
    delta = se3.difference(T_hat, truth)
    R = np.kron(np.eye(2), T_hat[:3, :3])
    scale = np.repeat([1.0, model.radius], 3)
    open_ = open_directions(problem) @ R.T
    seen = delta * scale
    seen = (seen - open_.T @ (open_ @ seen)) / scale
    return Verdict(float(np.linalg.norm(seen[:3])), float(np.linalg.norm(seen[3:])))


def open_directions(problem: Problem) -> np.ndarray:
    """Returns the directions (k, 6) of (δp, radius δθ), object's axes, that the true contacts leave unobservable."""
    scene, model = problem.scene, problem.model
    points, normals = scene.points_object, scene.normals_object
    values = model.fine.evaluate(points)
    variance = np.diagonal(scene.contacts.covariance, axis1=1, axis2=2)
    sigma_point, sigma_normal = np.sqrt(variance[:, 0]), np.sqrt(variance[:, 3:].sum(axis=1) / 2)
    information = np.zeros((6, 6))
    for i, point in enumerate(points):
        move = np.hstack([-np.eye(3), se3.skew(point)])  # of the contact, in the object, by (δp, δθ)
        turn = np.hstack([np.zeros((3, 3)), -se3.skew(normals[i])])
        rows = np.vstack(
            [
                values.gradient[i] @ move / sigma_point[i],
                (values.hessian[i] @ move + turn) / max(sigma_normal[i], model.sigma_normal, 1e-6),
            ]
        )
        information += rows.T @ rows
    # Read at the object's center: an origin far away swings by metres where the object itself hardly turns.
    metres = np.diag(np.r_[np.ones(3), np.ones(3) / model.radius])
    to_origin = np.block([[np.eye(3), se3.skew(model.center_object)], [np.zeros((3, 3)), np.eye(3)]]) @ metres
    values, vectors = np.linalg.eigh(to_origin.T @ information @ to_origin)
    open_ = np.linalg.solve(metres, to_origin @ vectors[:, values < 1 / (OPEN * model.radius) ** 2])
    return np.linalg.qr(open_)[0].T


def accuracy(verdicts: list[Verdict]) -> dict[str, Any]:
    """Returns the share of right answers, and their median shift and rotation."""
    good = [v for v in verdicts if v.found]
    return {
        "problems": len(verdicts),
        "success": len(good) / len(verdicts),
        "median_mm": 1e3 * float(np.median([v.shift for v in good])) if good else None,
        "median_deg": float(np.rad2deg(np.median([v.turn for v in good]))) if good else None,
    }
