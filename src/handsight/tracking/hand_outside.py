"""The hand's own links as outside evidence: where they are, with what sigma, and which are smaller than their shapes.

A hand's file often has shapes larger than the hand: capsules and boxes that bulge over its skin. Such a link would be
inside an object that the fingertips hold, and walls where there is nothing bend the answer or make contacts look wrong.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from typing import NamedTuple

import numpy as np

from handsight import checks
from handsight.correction import Outside, PoseEstimate
from handsight.objects import ObjectModel
from handsight.rig import Rig


class HandOutsideOptions(NamedTuple):
    """`HandOutsideOptions` say how the hand's links are kept outside the object."""

    sigma_surface: float = 0.001
    """Error of a link's surface beside that of its joints, per axis [m]: soft skin, facets, screws."""
    conflict: float = 3.0
    """A link that is deeper inside the object, in standard deviations, contradicts the contacts."""
    weaker: float = 4.0
    """Factor on the links' standard deviations when their depth is measured: then they still count along what contacts
    leave open, but not against contacts.
    """
    check_period: float = 0.1  # between two checks for links inside [s]
    note_period: float = (
        0.2  # between two notes of one link's depth, lest one bad pose is noted repeatedly [s]
    )
    min_notes: int = 5  # a link with so many is smaller than its shape
    max_notes: int = 25  # that are kept, the last ones
    max_margin: float = 0.02
    """No shape is larger than its link by more [m]: where it is deeper inside, the pose is wrong."""


HAND_OUTSIDE = HandOutsideOptions()


Solve = Callable[[Outside], PoseEstimate]


@dataclass(frozen=True, slots=True)
class LinkMargins:
    """A `LinkMargins` says how much smaller links are than their shapes, learnt where contacts fit."""

    notes: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    """By link: stamps [s], and how deep it was inside the object [m]."""

    @property
    def known(self) -> dict[str, float]:
        """By link with enough notes, its margin: their median [m]."""
        return {
            link: median(depth for _, depth in notes)
            for link, notes in self.notes.items()
            if len(notes) >= HAND_OUTSIDE.min_notes
        }

    def noted(self, depths: Mapping[str, float], stamp: float) -> "LinkMargins":
        """Returns the value with the depths [m] of links that are inside, but for those noted just before."""
        new = {
            link: (*earlier[1 - HAND_OUTSIDE.max_notes :], (stamp, depth))
            for link, depth in depths.items()
            if not (earlier := self.notes.get(link, ()))
            or abs(stamp - earlier[-1][0]) >= HAND_OUTSIDE.note_period - 1e-9
        }
        return replace(self, notes={**self.notes, **new}) if new else self


class HandOutside:
    """A `HandOutside` is the links of a rig's hand without its fingertips, which have shapes of their own."""

    def __init__(self, rig: Rig, model: ObjectModel, count: int) -> None:
        """`count`: of points on them; there are none where the hand's file has no shapes, or the object no inside."""
        frames = [finger.frame for finger in rig.fingers.values()]
        self._surface = rig.hand.surface(count if model.closed else 0, without=frames)
        self._model = model
        self._variance_joint = rig.sigma_joint_offset**2 + rig.sigma_joint**2
        self.links = self._surface.bodies
        """The links that have points."""
        self._first = np.searchsorted(self._surface.body_of, np.arange(len(self.links)))

    def at(self, joint_positions: Mapping[str, float] | None, margins: LinkMargins) -> Outside | None:
        """Returns the links at joint positions; None where a joint is missing, or there are no points."""
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
        return Outside(points, sigmas=given[1], links=given[2], slacks=slacks)  # which says what is wrong

    def reconciled(
        self, estimate: PoseEstimate, outside: Outside, solve: Solve
    ) -> tuple[PoseEstimate, dict[str, float]]:
        """Returns the estimate, and by link that is inside the object though contacts fit, how deep [m].

        Where there are such links, or contacts fit only without them, the estimate is solved again with weaker links.
        `solve` estimates the pose with other outside evidence.
        """
        fits = estimate.consistent and not estimate.outliers
        if fits and not self._conflicts(estimate, outside):
            return estimate, {}
        yielding = solve(replace(outside, sigmas=HAND_OUTSIDE.weaker * np.asarray(outside.sigmas)))
        if not yielding.consistent or yielding.outliers:
            return estimate, {}
        return yielding, self._conflicts(yielding, outside)

    def _conflicts(self, estimate: PoseEstimate, outside: Outside) -> dict[str, float]:
        """Returns, by link that is deeper inside than its joints, skin and margin explain, how deep [m].

        The depth includes the margin.
        """
        T, (least, most) = estimate.T_palm_object, self._model.bounds_object
        places = (np.asarray(outside.points_palm) - T[:3, 3]) @ T[:3, :3]
        in_bounds = ((places > least) & (places < most)).all(axis=1)
        if not in_bounds.any():  # as a rule; distances take ten times as long
            return {}
        depth = -self._model.fine.evaluate(places).distance
        slacks = 0.0 if outside.slacks is None else np.asarray(outside.slacks)
        beyond = np.maximum.reduceat((depth - slacks) / np.asarray(outside.sigmas), self._first)
        deepest = np.maximum.reduceat(depth, self._first)
        inside = np.flatnonzero((beyond > HAND_OUTSIDE.conflict) & (deepest < HAND_OUTSIDE.max_margin))
        return {self.links[i]: float(deepest[i]) for i in inside}
