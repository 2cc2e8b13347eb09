"""Corrections by many contacts, or by contacts that share errors: a search with a few of them, then all of them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight._kernels import records
from handsight._kernels.solve import registration
from handsight._kernels.solve.options import REGISTRATION, SEARCH
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import conflicts, modes, outliers, starts
from handsight.correction.estimate import Conflict, PoseEstimate
from handsight.correction.problem import Budget, Problem, Records, descents_at, poses_of
from handsight.correction.solve import residuals, solve
from handsight.objects import ObjectModel

FEW = 64
"""Contacts up to which all of them take part in the search, if none share an error; of more, so many do."""
MOST_CANDIDATES = 4
"""Minima of the search from which the pose is registered, the cheapest."""
MOST_AGAIN = 4
"""Further descents from a minimum that is doubtful."""
CROWD = 0.005
"""Distance on the surface within which contacts meet the same error of the model [m]."""
MOST_WRONG = 1 / 3
"""Share of wrong contacts from which on the rest is no evidence that this is the object."""
MOST_EXCESS = 2.0
"""By which factor declared variances may be too small before the evidence counts as inconsistent: of thousands of
contacts a χ² test alone would find any."""


def is_registered(contacts: Contacts) -> bool:
    """Returns whether a correction by these contacts is by registration."""
    return len(contacts.points_palm) > FEW or len(contacts.shared_covariance) > 0


class Registration(NamedTuple):
    """A `Registration` is where a descent by all contacts has led."""

    row: np.void
    """ANSWER."""
    squares: Array
    """(n, 3) squared residuals of the contacts, and the probabilities that one is right and that its distance is."""
    groups: Records
    """(g + 1,) GROUP."""

    @property
    def wrong_groups(self) -> Indices:
        """Groups whose error is larger than declared."""
        return np.flatnonzero(self.groups["weight"][:-1] < 0.5)

    def wrong(self, contacts: Contacts) -> Mask:
        """Returns whether each contact (n,) is wrong, by itself or with its group."""
        alone = self.squares[:, 1] + self.squares[:, 2] < 0.5
        return np.asarray(alone | np.isin(contacts.group, self.wrong_groups))

    @property
    def doubtful(self) -> bool:
        """Whether the cost, also of wrong contacts, is three deviations above that of right ones."""
        rows = float(self.row["rows"])
        return bool(self.row["cost"] > rows + 3 * np.sqrt(2 * rows))

    def fits(self, problem: Problem) -> bool:
        """Returns whether the right contacts pass the χ² test or, where they are many, miss by little more than they
        are said to, and wrong ones are few."""
        freedom = max(int(self.row["rows"]) - (6 if problem.blind else 0), 1)
        most = MOST_EXCESS * freedom if freedom > REGISTRATION.many_rows else 0.0
        most = max(modes.chi2_limit(freedom, conflicts.POOL), most)
        return bool(self.row["chi2"] <= most and self.wrong(problem.contacts).mean() < MOST_WRONG)


def register(problem: Problem, budget: Budget) -> PoseEstimate:
    """Returns the answer to a problem of many contacts; from `problem.starts`, if there are any."""
    contacts, n = problem.contacts, len(problem.contacts)
    few = problem
    if n > FEW:
        few = replace(problem, contacts=contacts.select(spread(contacts, FEW)), taxels=0)
    poses = problem.starts
    if poses is None:
        alone = replace(few, contacts=few.contacts.with_own_errors())
        everyone = np.ones((1, len(few.contacts)), dtype=bool)
        begin = outliers.first_starts(alone, starts.usual(alone))
        poses = poses_of(solve(alone, begin[None], everyone, budget).minima[:MOST_CANDIDATES])
    if len(poses) > 1 and n > FEW:
        rows = np.array([registered(few, T).row for T in poses])
        poses = rows["T_palm_object"][rows["cost"] < rows["cost"].min() + 2 * SEARCH.unlikely]
    found = [registered(problem, T) for T in poses]
    found.sort(key=lambda each: -float(each.row["log_weight"]))
    # A descent may have ended with a group moved to a wrong place; from the same pose without errors it goes on.
    for _ in range(MOST_AGAIN):
        if not found[0].doubtful or budget.spent():
            break
        again = registered(problem, found[0].row["T_palm_object"])
        if again.row["cost"] > found[0].row["cost"] - 1.0:
            break
        found.insert(0, again)
    best, Ts = found[0], np.array([each.row["T_palm_object"] for each in found])
    answers = [
        found[k].row for k in modes.distinct(problem.model, Ts, np.arange(len(Ts)), modes.MODES.max_modes)
    ]
    share = np.exp([row["log_weight"] - best.row["log_weight"] for row in answers])
    for row, weight in zip(answers, share / share.sum(), strict=True):
        row["weight"], row["converged"] = weight, row["converged"] and not budget.cut_short
    wrong, contradictions = best.wrong(contacts), _conflicts(problem, best)
    return PoseEstimate(
        np.array(answers),
        residuals(problem, Ts[0]),
        best.fits(problem) and all(conflict.excluded for conflict in contradictions),
        tuple(np.flatnonzero(wrong).tolist()),
        conflicts=contradictions,
    )


def spread(contacts: Contacts, number: int) -> Indices:
    """Returns the indices of `number` contacts, a power of two, that are spread as all of them are.

    The contacts are halved by the median along the coordinate, of point or normal, in which they differ most, and so
    on; of each part the one nearest to its median is taken, so that no more are wrong than of all.
    """
    scale = np.ptp(contacts.points_palm, axis=0).max() / 4 + 1e-12
    x = np.hstack([contacts.points_palm / scale, contacts.normals_palm])
    # As many in each part, evenly chosen from very many; what does not divide is left out.
    size = min(len(x) // number, 64)
    parts = (np.arange(number * size) * len(x) // (number * size))[None]
    while len(parts) < number:
        each = x[parts]
        along = np.ptp(each, axis=1).argmax(axis=1)
        values = np.take_along_axis(each, along[:, None, None], axis=2)[:, :, 0]
        order = np.argpartition(values, parts.shape[1] // 2, axis=1)
        parts = np.take_along_axis(parts, order, axis=1).reshape(2 * len(parts), -1)
    each = x[parts]
    off = np.abs(each - np.median(each, axis=1, keepdims=True)).sum(axis=2)
    return np.asarray(parts[np.arange(number), off.argmin(axis=1)])


def registered(problem: Problem, T: Array) -> Registration:
    """Returns where a descent from a pose (4, 4) leads."""
    model, contacts = problem.model, problem.contacts
    center = contacts.points_palm.mean(axis=0)
    groups = _groups(contacts, center, model.radius)
    of_group = np.where(contacts.group < 0, len(groups) - 1, contacts.group)
    answer, squares = np.zeros(1, dtype=records.ANSWER), np.empty((len(contacts), 3))
    answer["pose"] = descents_at(T[None])["pose"]
    evidence = *model.record[:2], contacts.record, _crowds(model, contacts, T), of_group, groups, center
    registration.register(*evidence, problem.constraints, problem.outside, squares, answer)
    return Registration(answer[0], squares, groups)


def _groups(contacts: Contacts, center: Array, radius: float) -> Records:
    """Returns GROUP (g + 1,) without errors; the last one is of contacts without a group."""
    shared, count = contacts.shared_covariance, len(contacts.shared_covariance)
    groups = np.zeros(count + 1, dtype=records.GROUP)
    groups["pose"]["rotation"], groups["weight"], groups["softness"] = np.eye(3), 1.0, 1.0
    for g in range(count):
        own = contacts.points_palm[contacts.group == g]
        lever = (own.mean(axis=0) if len(own) else center) - center
        by_step = np.eye(6)
        by_step[:3, 3:] = -se3.skew(lever)
        by_step[:, 3:] /= radius
        groups["information"][g] = by_step.T @ np.linalg.inv(shared[g] + 1e-12 * np.eye(6)) @ by_step
    return groups


def _crowds(model: ObjectModel, contacts: Contacts, T: Array) -> Array:
    """Returns how many contacts (n,) are in the same cell of the object's space, at a pose (4, 4)."""
    if model.record.model[0]["fine"]["kind"] not in (records.GRID, records.SHEET):
        return np.ones(len(contacts))
    cells = np.floor(se3.apply(se3.inverse(T), contacts.points_palm) / CROWD).astype(np.int64)
    _, cell, counts = np.unique(cells @ [1, 1 << 20, 1 << 40], return_inverse=True, return_counts=True)
    return counts[cell].astype(float)


def _conflicts(problem: Problem, best: Registration) -> tuple[Conflict, ...]:
    """Returns what contradicts the rest: vision, and the wrong groups, which are left out."""
    found, chi2 = [], float(best.row["prior_gain"])
    freedom = conflicts.prior_freedom(problem, int(best.row["rows"]))
    if problem.vision is not None and chi2 > modes.chi2_limit(freedom, conflicts.KIND):
        T = registered(replace(problem, vision=None), best.row["T_palm_object"]).row["T_palm_object"]
        offset = se3.difference(T, problem.vision.T_palm_object)
        p_value = modes.chi2_survival(chi2, freedom)
        found.append(Conflict("vision", "contacts", chi2, freedom, p_value, offset))
    for g in best.wrong_groups:
        chi2 = float(best.groups[g]["square"])
        p_value = modes.chi2_survival(chi2, 6)
        found.append(Conflict(f"group {g}", "other contacts", chi2, 6, p_value, np.empty(0), excluded=True))
    return tuple(found)
