"""The object's pose in the palm by all but touch: by vision, by the table, and by how palm and object have moved."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.objects import ObjectModel
from handsight.observation import Observation, seconds
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import HandView
from handsight.tracking.grasp import GraspChange, GraspState, slid
from handsight.tracking.measurements import EYE, VisionUpdate
from handsight.tracking.smoother import Motion, PoseBiasSmoother, process_variance
from handsight.tracking.table import Support, TableEvidence

REGRASP_POSITION = 0.005
REGRASP_ROTATION = float(np.deg2rad(3))
"""How far the object may be pushed [m] and turned [rad] when a finger comes or goes, one sigma per axis."""
REGRASP_NOISE = np.repeat([REGRASP_POSITION**2, REGRASP_ROTATION**2], 3)
"""(6,) variance of that motion [m², rad²]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Belief:
    """The object's pose without touch, and whether the hand holds it.

    Touch is not part of it: a contact stays the same while the hand holds still, and would be counted again at every
    instant. Each correction fuses it anew with `prior`.
    """

    start: PosePrior | None
    """The object's pose in the palm at the start of the track, given by the user; None: unknown."""
    vision: VisionUpdate
    """The gate of vision's poses."""
    process_noise: Array
    """(6,) variance of the object's random walk in the palm, per second [m², rad²]."""
    smoother: PoseBiasSmoother | None
    """The pose and vision's errors, by vision alone; None before there was a start or vision."""
    seen_at: float = -math.inf
    """When vision last measured the pose [s]."""
    table: TableEvidence | None = None
    """What the table tells of the object since it was grasped on it; None where it was not."""
    grasp: GraspState = field(default_factory=GraspState)
    T_world_palm: Array | None = None
    """(4, 4) the last known pose of the palm; None before it was measured."""

    @classmethod
    def initial(cls, rig: Rig, model: ObjectModel, start: PosePrior | None, process_noise: Array) -> "Belief":
        """Returns the belief before any observation."""
        vision = VisionUpdate(rig, model)
        smoother = _started(vision, start)
        return cls(start=start, vision=vision, process_noise=process_noise, smoother=smoother)

    @property
    def known(self) -> PoseBiasSmoother:
        """The smoother, where there is one."""
        assert self.smoother is not None
        return self.smoother

    @property
    def prior(self) -> PosePrior:
        """The pose by vision and the likeliest support, as the prior of a correction."""
        smoother = self.known
        if self.table is not None:
            smoother = self.table.smoother(smoother)
        return smoother.without_touch

    @property
    def stands(self) -> bool:
        """Whether a grasped object still stands on the table."""
        return self.vision.rig.table is not None and not self.grasp.carried

    def walked(self, stamp: float, since: float) -> Array:
        """Returns the variance (6,) of the object's motion in the palm between two stamps [m², rad²]."""
        noise = process_variance(self.process_noise, seconds(stamp, since))
        return noise + REGRASP_NOISE if self.grasp.changed > since else noise

    def predicted(
        self, stamp: float, last: float, fingers: tuple[str, ...], T_world_palm: Array | None
    ) -> tuple["Belief", GraspChange | None]:
        """Returns the belief at the stamp of an observation, after `last`, and how the grasp has changed.

        `fingers` touch now; `T_world_palm` (4, 4) is None where it was not measured.
        """
        palm = self.T_world_palm if T_world_palm is None else T_world_palm
        grasp, change = self.grasp.after(fingers, stamp, palm)
        there = replace(self, grasp=grasp, T_world_palm=palm)
        if T_world_palm is not None and self.T_world_palm is not None:
            there = there._carried(self, T_world_palm)
        if there.smoother is None or not stamp > last > -math.inf:
            return there, change
        elapsed = seconds(stamp, last)
        smoother = there.smoother.inflated(self.process_noise * elapsed, elapsed)
        return replace(there, smoother=smoother), change

    def _carried(self, before: "Belief", T_now: Array) -> "Belief":
        """Returns the belief after the palm has moved to T_now (4, 4): an object that is not grasped stays where it is
        in the world, one that stands on the table slides with the palm, and any other moves with the palm."""
        T_before = np.asarray(before.T_world_palm)
        grasped = before.grasp.grasped
        stands = before.stands and self.stands
        if np.array_equal(T_before, T_now) or (grasped and not stands):
            return self
        motion = slid(T_before, T_now) if grasped else EYE
        T_new_old = se3.inverse(T_now) @ motion @ T_before
        smoother = None if self.smoother is None else self.smoother.transformed(T_new_old)
        table = None if self.table is None else self.table.transformed(T_new_old, T_now)
        return replace(self, smoother=smoother, table=table)

    def regrasped(
        self, stamp: float, change: GraspChange, supports: tuple[Support, ...], touch: PoseEstimate | None
    ) -> "Belief":
        """Returns the belief after fingers came or went, which may have pushed the object.

        `supports`: what may bear it while it is on the table. `touch`: what contacts have told of a released object's
        pose; that stays true, while its motion from now on is unknown. None: nothing.
        """
        smoother = self.known
        table, T = self.vision.rig.table, self.T_world_palm
        pose = smoother.now
        if touch is not None:
            pose = pose.given_pose(touch.T_palm_object, touch.information)
        pose = pose.inflated(REGRASP_NOISE)
        evidence = None if change == "released" else self.table
        if change != "released" and table is not None and T is not None and not self.grasp.lifted:
            evidence = TableEvidence.of(self.vision.model, table, supports, pose, T, stamp)
        elif evidence is not None:
            evidence = evidence.restarted(smoother, np.diag(REGRASP_NOISE))
        return replace(self, smoother=smoother.restarted(pose), table=evidence)

    def slipped(self, motion: Array) -> "Belief":
        """Returns the belief after the object may have slipped by a motion of covariance (6, 6)."""
        smoother = self.known
        table = None if self.table is None else self.table.restarted(smoother, motion)
        return replace(self, smoother=smoother.restarted(smoother.now.spread(motion)), table=table)

    def with_hand(self, view: HandView) -> "Belief":
        """Returns the belief after an image has shown the palm, which tells the camera's constant error."""
        vision, smoother = self.vision.palm_detected(view, self.smoother)
        table = self.table
        if table is not None and self.smoother is not None and smoother is not self.smoother:
            table = table.informed(self.smoother, view.bias(self.smoother.pivot))
        return replace(self, vision=vision, smoother=smoother, table=table)

    def with_vision(
        self, observation: Observation, T_world_palm: Array | None, motion: Motion, T_then_now: Array
    ) -> "Belief":
        """Returns the belief after vision's pose of an observation; the others are those of `VisionUpdate.updated`."""
        before = self.smoother
        vision, smoother = self.vision.updated(observation, before, T_world_palm, motion, T_then_now)
        anew = False
        if smoother is not None and before is not None:  # vision starts anew where the object was moved
            anew = bool((smoother.process_noise < before.process_noise).any())
        return replace(self, vision=vision, smoother=smoother, table=None if anew else self.table)

    def lost(self) -> "Belief":
        """Returns the belief from the track's start: the palm is so far away that the hand cannot hold the object."""
        return replace(self, smoother=_started(self.vision, self.start))

    def widened(self, more: Array) -> "Belief":
        """Returns the belief with `more` (6,) variance of the pose [m², rad²]."""
        smoother = self.known
        table = None if self.table is None else self.table.restarted(smoother, np.diag(more))
        return replace(self, smoother=smoother.restarted(smoother.now.inflated(more)), table=table)

    def afresh(self) -> "Belief":
        """Returns the belief by vision's last pose alone, if there was one."""
        smoother = self.vision.afresh()
        return self if smoother is None else replace(self, smoother=smoother, table=None)


def _started(vision: VisionUpdate, start: PosePrior | None) -> PoseBiasSmoother | None:
    """Returns the smoother at the start of a track; None where the object's pose is unknown."""
    if start is None:
        return None
    return vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))
