"""The hand's own links as outside evidence: their poses, their sigmas, and which are smaller than their shapes.

A hand's file often has shapes larger than the hand: capsules and boxes that bulge over its skin. Such a shape is then
inside an object that the fingertips hold, which would bias the pose, or make contacts look like outliers.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from typing import NamedTuple

import numpy as np

from handsight import checks
from handsight.correction import Outside, PoseEstimate
from handsight.correction.problem import Steps
from handsight.objects import ObjectModel
from handsight.rig import Rig


class HandOutsideOptions(NamedTuple):
    """`HandOutsideOptions` say how the hand's links are kept outside the object."""

    sigma_surface: float = 0.001
    """Error of a link's surface in addition to that of its joints, per axis [m]: soft skin, facets, screws."""
    conflict: float = 3.0
    """A link that is deeper inside the object than this, in standard deviations, contradicts the contacts."""
    weaker: float = 4.0
    """Factor on the links' standard deviations when their depth is measured: then they still bound directions that the
    contacts leave open, but do not outweigh contacts.
    """
    check_period: float = 0.1  # time between two checks for links inside the object [s]
    note_period: float = 0.2
    """Least time between two notes of one link's depth, so that one bad pose is noted once [s]."""
    min_notes: int = 5  # so many notes say that a link is smaller than its shape
    max_notes: int = 25  # the most notes of a link that are kept, the last ones
    max_margin: float = 0.02
    """No shape is larger than its link by more [m]: where it is deeper inside the object, the pose is wrong."""


HAND_OUTSIDE = HandOutsideOptions()


Solve = Callable[[Outside], Steps[PoseEstimate]]


@dataclass(frozen=True, slots=True)
class LinkMargins:
    """`LinkMargins` are how much smaller than their shapes links are, learnt from poses that contacts fit."""

    notes: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    """By link: (stamp [s], depth inside the object [m]) of each note."""

    @property
    def known(self) -> dict[str, float]:
        """By link with enough notes, its margin: the median of their depths [m]."""
        enough = {link: n for link, n in self.notes.items() if len(n) >= HAND_OUTSIDE.min_notes}
        return {link: median(depth for _, depth in notes) for link, notes in enough.items()}

    def noted(self, depths: Mapping[str, float], stamp: float) -> "LinkMargins":
        """Returns the value with notes of the links' depths inside the object [m], unless noted just before."""
        new = {
            link: (*earlier[1 - HAND_OUTSIDE.max_notes :], (stamp, depth))
            for link, depth in depths.items()
            if not (earlier := self.notes.get(link, ()))
            or abs(stamp - earlier[-1][0]) >= HAND_OUTSIDE.note_period - 1e-9
        }
        return replace(self, notes={**self.notes, **new}) if new else self


class HandOutside:
    """A `HandOutside` makes outside evidence of the links of a rig's hand, all but its fingertips."""

    def __init__(self, rig: Rig, model: ObjectModel, count: int) -> None:
        """`count`: number of points; there are none if the hand's file has no shapes, or the object's mesh is open."""
        frames = [finger.frame for finger in rig.fingers.values()]
        self._surface = rig.hand.surface(count if model.closed else 0, without=frames)
        self._model = model
        self._variance_joint = rig.sigma_joint_offset**2 + rig.sigma_joint**2
        self.links = self._surface.bodies
        """The links that have points."""
        self._first = np.searchsorted(self._surface.body_of, np.arange(len(self.links)))

    def at(self, joint_positions: Mapping[str, float] | None, margins: LinkMargins) -> Outside | None:
        """Returns the links' points at joint positions; None where a joint is missing, or there are no points."""
        surface = self._surface
        if not self.links or joint_positions is None or not joint_positions.keys() >= set(surface.joints):
            return None
        points, levers = surface.points_and_sensitivities(joint_positions)
        sigmas = np.sqrt(self._variance_joint * levers**2 + HAND_OUTSIDE.sigma_surface**2)
        known = margins.known
        slacks = np.array([known.get(link, 0.0) for link in self.links])[surface.body_of] if known else None
        given = points, sigmas[surface.body_of], surface.body_of, slacks
        if np.abs(points).max() <= checks.MAX_DISTANCE:
            return Outside.trusted(*given)
        return Outside(points, sigmas=given[1], links=given[2], slacks=slacks)  # raises InvalidInput

    def reconciled(
        self, estimate: PoseEstimate, outside: Outside, solve: Solve
    ) -> Steps[tuple[PoseEstimate, dict[str, float]]]:
        """Returns the estimate, and by link that is inside the object although contacts fit, its depth [m].

        Where there are such links, or where contacts do not fit, the pose is estimated again with weaker links, and
        that estimate is returned if contacts fit it. `solve` estimates the pose with other outside evidence.
        """
        fits = estimate.consistent and not estimate.outliers
        if fits and not self._conflicts(estimate, outside):
            return estimate, {}
        yielding = yield from solve(replace(outside, sigmas=HAND_OUTSIDE.weaker * np.asarray(outside.sigmas)))
        if not yielding.consistent or yielding.outliers:
            return estimate, {}
        return yielding, self._conflicts(yielding, outside)

    def _conflicts(self, estimate: PoseEstimate, outside: Outside) -> dict[str, float]:
        """Returns, by link deeper inside the object than sigma and margin explain, its depth with the margin [m]."""
        T, (least, most) = estimate.T_palm_object, self._model.bounds_object
        places = (np.asarray(outside.points_palm) - T[:3, 3]) @ T[:3, :3]
        in_bounds = ((places > least) & (places < most)).all(axis=1)
        if not in_bounds.any():  # mostly so; the distances below take ten times as long
            return {}
        depth = -self._model.fine.evaluate(places).distance
        slacks = 0.0 if outside.slacks is None else np.asarray(outside.slacks)
        beyond = np.maximum.reduceat((depth - slacks) / np.asarray(outside.sigmas), self._first)
        deepest = np.maximum.reduceat(depth, self._first)
        inside = np.flatnonzero((beyond > HAND_OUTSIDE.conflict) & (deepest < HAND_OUTSIDE.max_margin))
        return {self.links[i]: float(deepest[i]) for i in inside}
