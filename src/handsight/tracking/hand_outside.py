"""The hand's own links as outside evidence: their poses and their sigmas.

A hand's file often has shapes larger than the hand: capsules and boxes that bulge over its skin. Such a shape is then
inside an object that the fingertips hold, which would bias the pose, or make contacts look like outliers.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from handsight.correction import Outside, PoseEstimate
from handsight.objects import ObjectModel
from handsight.rig import Rig

SIGMA_SURFACE = 0.001
"""Error of a link's surface in addition to that of its joints, per axis [m]: soft skin, facets, screws."""
LINK_CONFLICT = 3
"""A link that is deeper inside the object than this, in standard deviations, contradicts the contacts."""
WEAKER_LINKS = 4
"""Factor on the links' standard deviations when their depth is measured: then they still bound directions that the
contacts leave open, but do not outweigh contacts.
"""
MAX_MARGIN = 0.02
"""No shape is larger than its link by more [m]: where it is deeper inside the object, the pose is wrong."""


Solve = Callable[[Outside], PoseEstimate]


class HandOutside:
    """Makes outside evidence of the links of a rig's hand, all but its fingertips."""

    def __init__(self, rig: Rig, model: ObjectModel, count: int) -> None:
        """`count`: number of points; there are none if the hand's file has no shapes, or the object's mesh is open."""
        frames = [finger.frame for finger in rig.fingers.values()]
        self._surface = rig.hand.surface(count if model.closed else 0, without=frames)
        self._model = model
        sigma = math.hypot(rig.sigma_joint_offset, rig.sigma_joint)
        self._errors = rig.joint_errors(self._surface.joints, sigma)
        self.links = self._surface.bodies
        """The links that have points."""
        self._first = np.searchsorted(self._surface.body_of, np.arange(len(self.links)))

    def at(self, joint_positions: Mapping[str, float] | None) -> Outside | None:
        """Returns the links' points at joint positions; None where a joint is missing, or there are no points."""
        surface = self._surface
        if not self.links or joint_positions is None or not joint_positions.keys() >= set(surface.joints):
            return None
        points, levers = surface.points_and_sensitivities(joint_positions, self._errors)
        sigmas = np.hypot(levers, SIGMA_SURFACE)
        return Outside(points, sigmas=sigmas[surface.body_of], links=surface.body_of)

    def reconciled(self, estimate: PoseEstimate, outside: Outside, solve: Solve) -> PoseEstimate:
        """Returns the estimate, or, where a link is inside the object or contacts do not fit, one with weaker links.

        That is returned if contacts fit it. `solve` estimates the pose with other outside evidence.
        """
        fits = estimate.consistent and not estimate.outliers
        if fits and not self._any_inside(estimate, outside):
            return estimate
        yielding = solve(replace(outside, sigmas=WEAKER_LINKS * np.asarray(outside.sigmas)))
        if not yielding.consistent or yielding.outliers:
            return estimate
        return yielding

    def _any_inside(self, estimate: PoseEstimate, outside: Outside) -> bool:
        """Returns whether any link is deeper inside the object than its sigma explains, and its shape may be wrong."""
        T = estimate.T_palm_object
        places = (np.asarray(outside.points_palm) - T[:3, 3]) @ T[:3, :3]
        depth = -self._model.fine.evaluate(places).distance
        beyond = np.maximum.reduceat(depth / np.asarray(outside.sigmas), self._first)
        deepest = np.maximum.reduceat(depth, self._first)
        return bool(((beyond > LINK_CONFLICT) & (deepest < MAX_MARGIN)).any())
