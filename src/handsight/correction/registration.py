"""Corrections by many contacts, or by contacts that share errors: a search with a few of them, then all of them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight._compiled import records
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes, outliers, starts
from handsight.correction.kernels import registration
from handsight.correction.kernels.search_options import ACCEPTANCE, REGISTRATION, SEARCH
from handsight.correction.problem import FEW, Problem, Records, descents_at, poses_of
from handsight.correction.solve import solve
from handsight.objects import ObjectModel

MOST_FEW = 16
MOST_CANDIDATES = 8
"""Minima of the search, the cheapest, from which a few contacts are registered; of the places that these lead to, those
from which all are."""
MOST_AGAIN = 4
"""Further descents from a minimum that is doubtful."""
CROWD = 0.005
"""Distance on the surface within which contacts meet the same error of the model [m]."""
MOST_WRONG = 1 / 3
"""Share of wrong contacts from which on the rest is no evidence that this is the object."""
MOST_EXCESS = 2
"""By which factor declared variances may be too small before the evidence counts as inconsistent: of thousands of
contacts a χ² test alone would find any."""


class Registration(NamedTuple):
    """Where a descent by all contacts has led."""

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

    def wrong_alone(self, contacts: Contacts) -> Mask:
        """Returns whether each contact (n,) is wrong, and its group is not."""
        alone = self.squares[:, 1] + self.squares[:, 2] < 0.5
        return np.asarray(alone & ~np.isin(contacts.group, self.wrong_groups))

    def wrong(self, contacts: Contacts) -> Mask:
        """Returns whether each contact (n,) is wrong, by itself or with its group."""
        return np.asarray(self.wrong_alone(contacts) | np.isin(contacts.group, self.wrong_groups))

    @property
    def doubtful(self) -> bool:
        """Whether the cost, also of wrong contacts, is three deviations above that of right ones."""
        rows = float(self.row["rows"])
        return bool(self.row["cost"] > rows + 3 * np.sqrt(2 * rows))

    def fits(self, problem: Problem) -> bool:
        """Returns whether the right contacts pass the χ² test or, where they are many, miss by little more than they
        are said to, and wrong ones are few."""
        rows = int(self.row["rows"] + self.row["walls"])
        freedom = max(rows - (6 if problem.blind else 0), 1)
        most = MOST_EXCESS * freedom if freedom > REGISTRATION.many_rows else 0.0
        most = max(modes.chi2_limit(freedom, ACCEPTANCE.pool), most)
        return bool(self.row["chi2"] <= most and self.wrong(problem.contacts).mean() < MOST_WRONG)


def register(problem: Problem) -> list[Registration]:
    """Returns the distinct minima of a problem of many contacts, likeliest first; from `problem.starts`, if there are
    any."""
    contacts = problem.contacts
    n = len(problem.contacts)
    few = problem
    if n > FEW:
        few = replace(problem, contacts=contacts.select(spread(contacts, FEW)), taxels=0)
    poses = problem.starts
    if poses is None:
        alone = replace(few, contacts=few.contacts.with_own_errors())
        begin = outliers.first_starts(alone, starts.usual(alone))
        poses = poses_of(solve(alone, begin[None], alone.everyone).minima[:MOST_FEW])
        if modes.has_detail(problem.model):  # many minima beside each other, of which these are some
            poses = np.concatenate([poses, poses_of(begin[:MOST_FEW])])
        poses = _likely(few, poses)
    found = [registered(problem, T) for T in poses]
    found.sort(key=lambda each: -float(each.row["log_weight"]))
    # A descent may have ended with a group moved to a wrong place; from the same pose without errors it goes on.
    for _ in range(MOST_AGAIN):
        if not found[0].doubtful:
            break
        again = registered(problem, found[0].row["T_palm_object"])
        if again.row["cost"] > found[0].row["cost"] - 1.0:
            break
        found.insert(0, again)
    distinct = list[Registration]()
    for each in found:
        if not any(_same(problem, each.row, other.row) for other in distinct):
            distinct.append(each)
    return distinct


def _likely(problem: Problem, poses: Array) -> Array:
    """Returns the poses (k, 4, 4) that a few contacts lead to from some, those that are not much dearer than the
    cheapest, and more than a standard deviation from each other."""
    rows = np.array([registered(problem, T).row for T in poses])
    rows = rows.take(np.argsort(rows["cost"], kind="stable"))
    chosen = list[np.void]()
    for row in rows[rows["cost"] < rows["cost"][0] + 2 * SEARCH.unlikely]:
        if len(chosen) < MOST_CANDIDATES and not any(_same(problem, row, other) for other in chosen):
            chosen.append(row)
    return np.array([row["T_palm_object"] for row in chosen])


def _same(problem: Problem, row: np.void, other: np.void) -> bool:
    """Returns whether one ANSWER is within a standard deviation of another."""
    T = problem.model.nearest(row["T_palm_object"][None], other["T_palm_object"])[0]
    step = se3.difference(T, other["T_palm_object"])
    return bool(step @ other["information"] @ step < 1)


def spread(contacts: Contacts, number: int) -> Indices:
    """Returns the indices of `number` contacts, a power of two, that are spread as all of them are, in whatever order
    these are.

    The contacts are halved by the median along the coordinate, of point or normal, in which they differ most, and so
    on; of each part the one nearest to its median is taken, so that no more are wrong than of all.
    """
    off = contacts.points_palm - contacts.points_palm.mean(axis=0)
    scale = np.ptp(off, axis=0).max() / 4 + 1e-12
    x = np.hstack([off / scale, contacts.normals_palm])
    # As many in each part, evenly chosen from very many by their distance; what does not divide is left out.
    size = min(len(x) // number, 64)
    by_distance = np.argsort(np.linalg.norm(off, axis=1), kind="stable")
    parts = by_distance[np.arange(number * size) * len(x) // (number * size)][None]
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
    answer = np.zeros(1, dtype=records.ANSWER)
    squares = np.empty((len(contacts), 3))
    answer["pose"] = descents_at(T[None])["pose"]
    evidence = *model.record[:2], contacts.record, _crowds(model, contacts, T), of_group, groups, center
    registration.register(*evidence, problem.constraints, problem.outside, squares, answer)
    return Registration(answer[0], squares, groups)


def _groups(contacts: Contacts, center: Array, radius: float) -> Records:
    """Returns GROUP (g + 1,) without errors; the last one is of contacts without a group."""
    shared = contacts.shared_covariance
    count = len(contacts.shared_covariance)
    groups = np.zeros(count + 1, dtype=records.GROUP)
    groups["pose"]["rotation"] = np.eye(3)
    groups["weight"] = 1.0
    groups["softness"] = 1.0
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
