"""The corrections that section III compares, each run on a simulated grasp, with a row of errors for each."""

import functools
from collections.abc import Iterable

import numpy as np

import handsight as hs
from experiments.shared.grasp_errors import open_sigma, pose_errors
from experiments.shared.grasp_trials import Trial, exact_model
from testbed import report, scenes
from testbed.report import Row, Rows

WEIGHTS_CM = (1, 2, 5, 10)
"""The weight w_n of the paper's normals."""
LEAST_FINGERS = 2
"""Fingers that the paper's method needs; with fewer, vision's pose stays."""
PAPER = {
    "paper-gd, w_n 10 cm": hs.PaperMethod(optimizer="gd"),
    "paper-lm, no normals": hs.PaperMethod(normals=False),
    **{f"paper-lm, w_n {w} cm": hs.PaperMethod(w_n=w / 100) for w in WEIGHTS_CM},
}
OURS = {
    f"{name}{', outside' * outside}{', table' * table}": (name, outside, table)
    for name in ("maximum", "best")
    for outside in (False, True)
    for table in (False, True)
}
"""Pose of the answer (its maximum, or its own, the mean where the maximum is at the end of a slide), whether points of
the hand are evidence, and whether the table is."""


@functools.cache
def warm() -> None:
    """Calls everything that is compiled at its first call, so that times are those of corrections."""
    model = scenes.box()
    points, normals = model.sample(4)
    contacts = hs.Contacts(points, normals, sigma_point=1e-3, sigma_normal=0.1)
    prior = hs.PosePrior.from_sigmas(np.eye(4), 0.05, 0.1)
    for outside in (None, points):
        hs.correct_pose(model, contacts, vision=prior, outside=outside)
    hs.correct_pose(model, contacts, vision=prior, method="paper-lm")


def rows_of(trial: Trial, methods: Iterable[str]) -> Rows:
    """Returns a row for each method (a name of `PAPER` or `OURS`), with its errors and vision's."""
    warm()
    rows = []
    for name in methods:
        estimate, seconds = None, 0.0
        if name in OURS or len(trial.contacts) >= LEAST_FINGERS:
            estimate, seconds = report.timed(functools.partial(corrected, trial, name))
        rows.append(_row(trial, name, estimate, seconds))
    return rows


def corrected(trial: Trial, name: str) -> hs.PoseEstimate:
    """Returns the estimate of one method."""
    if name in PAPER:
        return hs.correct_pose(trial.model, trial.contacts, vision=trial.vision, method=PAPER[name])
    pose, outside, table = OURS[name]
    estimate = hs.correct_pose(
        trial.model,
        trial.contacts,
        vision=trial.standing if table else trial.vision,
        outside=trial.outside if outside else None,
    )
    return scenes.at_maximum(estimate) if pose == "maximum" else estimate


def _row(trial: Trial, name: str, estimate: hs.PoseEstimate | None, seconds: float) -> Row:
    exact, sample = (
        exact_model(trial.scenario.object),
        trial.sample,
    )  # whatever the robot takes the object for
    key = {"object": trial.scenario.object, "seed": trial.scenario.seed, "method": name}
    key |= {"contacts": len(trial.contacts), "answered": estimate is not None}
    if estimate is None:
        errors = pose_errors(exact, trial.vision.T_palm_object, sample)
        return key | errors | {f"vision {k}": v for k, v in errors.items()}
    row = key | pose_errors(exact, estimate.T_palm_object, sample, estimate.unobservable)
    seen = pose_errors(exact, trial.vision.T_palm_object, sample, estimate.unobservable)
    row |= {f"vision {k}": v for k, v in seen.items()}
    row |= {"iterations": estimate.iterations, "ms": 1e3 * seconds, "consistent": estimate.consistent}
    if name in OURS:
        row |= {"open sigma": open_sigma(exact, estimate)} | scenes.region(
            exact, estimate, sample.T_palm_object
        )
    return row
