"""The object's pose in the palm over time: held between corrections, corrected when there is something new."""

from dataclasses import replace
from typing import Literal

import numpy as np

from handsight import checks, se3
from handsight._kernels.warm import warm_tracker
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior, correct_pose, follow_pose
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import answers
from handsight.tracking.belief import Belief
from handsight.tracking.contact_memory import ContactMemory, with_remembered
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.grip import Change, Grip
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.sight import Sight
from handsight.tracking.table import on_table

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"
WIDER = 9.0
"""How much more variance a prior gets where nothing fits: the search then begins from several starts."""
HOLD = 0.02
"""How old the growth of a held estimate's covariance may be [s]: a micrometre or so."""
RECOVERY_EVERY = 0.5
"""Seconds between two such searches, and between corrections while nothing fits: each costs a hundred others."""
RETRY_EVERY = 0.1
"""The same when the fingers that touch have changed since."""
LOST_WITHOUT_FIT = 2.0
"""So long contacts may contradict every pose before the object counts as lost [s]."""


class Tracker:
    """One object in one hand. Give it every observation; it answers with the pose at each.

    The object is fixed in the palm between corrections (the paper's assumption), its uncertainty growing; while nothing
    holds it, it is fixed in the world. It is corrected when a finger touches or lets go, when a contact has moved, when
    vision arrives, or at a set rate.
    """

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        start: PosePrior | None = None,
        settings: TrackerSettings | None = None,
    ) -> None:
        """`start`: where the object is in the palm at first, if the user knows; else the first seen pose starts."""
        if not isinstance(rig, Rig) or not isinstance(model, ObjectModel):
            came = f"{type(rig).__name__} and {type(model).__name__}"
            raise InvalidInput(f"tracker: expected a Rig and an ObjectModel, got {came}")
        warm_tracker()
        self.rig, self.model = rig, model
        self.settings = s = settings or TrackerSettings()
        self.state: State = "lost"
        self.reason = NO_POSE
        self.stamp: float | None = None
        self.touch = FingertipContacts((), None, {})
        self.belief: Belief | None = None
        self.estimate: PoseEstimate | None = None
        self.corrections = self.late = 0
        """How often the pose was corrected, and how many observations came after a later one and were left out."""
        self._fingertips, self.sight = FingertipSensors(rig), Sight(rig, model)
        self._memory = ContactMemory(s.memory)
        self._surface = rig.hand.surface(s.outside, without=self._fingertips.frames) if s.outside else None
        self._surface_joints = frozenset(self._surface.chains.joints) if self._surface else frozenset()
        self._walk = np.array([s.walk_position**2] * 3 + [s.walk_rotation**2] * 3)
        self._regrasp = np.array([s.regrasp_position**2] * 3 + [s.regrasp_rotation**2] * 3)
        self._grip = Grip()
        self._now = -np.inf
        self.T_world_palm: Array | None = None
        self._last: PoseEstimate | None = None
        self._corrected: Contacts | None = None
        self._corrected_fingers: tuple[str, ...] = ()
        self._corrected_at = self._heard_at = self._fits_at = self._recovered_at = -np.inf
        self._held: PoseEstimate | None = None
        self._held_at = -np.inf
        self._spread: tuple[PoseEstimate, float] | None = None
        if start is not None:
            self.belief = self.sight.begin(start.T_palm_object, start.covariance, np.zeros(3))

    def update(self, observation: Observation) -> PoseEstimate | None:
        """The pose in the palm now; None as long as there has been neither a start nor a pose from vision.

        `state` and `reason` say how far to trust it. An observation older than the last one changes nothing and is
        counted in `late`. Raises InvalidInput for what is wrong with the observation itself.
        """
        stamp = float(checks.finite(observation.stamp, "observation.stamp", ()))
        elapsed = 0.0 if self.stamp is None else stamp - self.stamp
        if elapsed < 0:
            self.late += 1
            return self.estimate
        if self.rig.world_from == "joints" and observation.T_world_palm is None:
            observation = self._standing_by_joints(observation)
        self.touch = self._fingertips.contacts(observation)
        self.stamp = self._now = stamp
        self._predict(observation, elapsed)
        seen = self._look(observation)
        if self.belief is None:
            return None
        if self._due(seen=seen):
            self._correct(self.belief, observation, seen=seen)
        self.estimate = self._held_by(self.belief)
        self.state, self.reason = self._judged(self.estimate)
        return self.estimate

    def _standing_by_joints(self, observation: Observation) -> Observation:
        """The observation with the palm's pose by the arm that the hand's file has."""
        if observation.joint_positions is None:
            return observation
        return replace(observation, T_world_palm=self.rig.hand.T_world_palm(observation.joint_positions))

    def _predict(self, observation: Observation, elapsed: float) -> None:
        """Where the object is believed before anything of this instant is used."""
        T = observation.T_world_palm
        if self.belief is not None:
            if not self._grip.held and T is not None and self.T_world_palm is not None:
                # Nothing holds it: it stays in the world while the palm goes.
                T_new_old = se3.inverse(T) @ self.T_world_palm
                self.belief = self.belief.carried(T_new_old)
                self._last = None
            if elapsed > 0:
                self.belief = self.belief.walked(self._walk * elapsed)
        if T is not None:
            self.T_world_palm = T
        self._memory.update(self.touch, self._now)
        change = self._grip.feel(self.touch.fingers, self._now)
        if change == "gripped":
            self._memory.only(self.touch.fingers)
        if self.belief is not None and change:
            self.belief = self._regripped(self.belief, change)

    def _regripped(self, belief: Belief, change: Change) -> Belief:
        """The belief after a finger came or went."""
        joint = belief.now
        if change == "released":
            # What touch has said outlives the grip, but not where the object is in the palm from now on.
            if self._last is not None:
                joint = joint.touched(self._last.T_palm_object, self._last.information)
            self._last = self._corrected = None
        joint = joint.walked(self._regrasp)
        T, table = self.T_world_palm, self.rig.table
        if (
            change != "released"
            and table is not None
            and T is not None
            and self._grip.standing(float(T[2, 3]))
        ):
            joint = on_table(joint, self.model, table, T) or joint
        return belief.settled(joint)

    def _look(self, observation: Observation) -> bool:
        """Takes in what vision saw; whether there was anything."""
        before = self.belief
        self.belief = self.sight.look(observation, before, self.T_world_palm)
        if self.belief is before:
            return False
        self._heard_at = self._now
        return True

    def _due(self, *, seen: bool) -> bool:
        """Whether vision or touch has something new to say, or touch has not been asked for long enough."""
        now, then = self.touch.contacts, self._corrected
        if now is None:
            return False
        regripped = self.touch.fingers != self._corrected_fingers
        if self._last is not None and not self._last.consistent:
            wait = RETRY_EVERY if regripped else RECOVERY_EVERY
            return self._now - self._corrected_at >= wait
        if seen or then is None or regripped:
            return True
        if self.settings.rate is not None and self._now - self._corrected_at >= 1 / self.settings.rate - 1e-9:
            return True
        shift = np.abs(now.points_palm - then.points_palm).max()
        cosine = (now.normals_palm * then.normals_palm).sum(axis=1).min()
        return bool(shift > self.settings.moved or cosine < np.cos(self.settings.turned))

    def _correct(self, belief: Belief, observation: Observation, *, seen: bool) -> None:
        """The pose from the belief and everything that is touched or remembered, anew."""
        remembered = self._memory.of_others(self.touch)
        contacts = with_remembered(self.touch, remembered, self._walk, self._now)
        if contacts is None:
            return
        T, covariance = belief.T_palm_object, belief.pose_covariance
        follow = None if seen or self.touch.fingers != self._corrected_fingers else self._last
        estimate = self._solved(contacts, PosePrior.trusted(T, covariance), observation, follow)
        if not estimate.consistent and self._now - self._recovered_at >= RECOVERY_EVERY:
            self._recovered_at = self._now
            wider = self._solved(contacts, PosePrior.trusted(T, WIDER * covariance), observation)
            if wider.consistent:
                estimate = wider
                self.belief = belief.settled(belief.now.walked((WIDER - 1) * np.diag(covariance)))
        felt = 0 if self.touch.contacts is None else len(self.touch.contacts)
        for i in estimate.outliers:
            if i >= felt:
                self._memory.forget(remembered[i - felt].finger)
        self._last, self._corrected = estimate, self.touch.contacts
        self._corrected_fingers, self._corrected_at = self.touch.fingers, self._now
        self.corrections += 1

    def _solved(
        self,
        contacts: Contacts,
        prior: PosePrior,
        observation: Observation,
        follow: PoseEstimate | None = None,
    ) -> PoseEstimate:
        """The answer; with `follow`, that estimate's own minimum if it still fits: nothing new asks for another."""
        outside, samples, joints = None, self.settings.samples, observation.joint_positions
        if self._surface is not None and joints is not None and self._surface_joints <= joints.keys():
            outside = self._surface.points_palm(joints)
        if follow is not None and follow.consistent and not follow.outliers and not samples:
            followed = follow_pose(self.model, contacts, prior, follow.T_palm_object, outside)
            if followed is not None:
                return followed
        return correct_pose(self.model, contacts, vision=prior, outside=outside, samples=samples)

    def _held_by(self, belief: Belief) -> PoseEstimate:
        """The last correction as it stands now; without one, the belief."""
        if self._last is None:
            self._held = None
            return answers.by_belief(belief)
        if self.estimate is None or self._held is not self._last or self._now - self._held_at > HOLD:
            self._held, self._held_at = self._last, self._now
            return answers.held(self._last, self._walk * (self._now - self._corrected_at))
        return self.estimate

    def vision_error(self) -> tuple[Array, Array] | None:
        """Vision's constant error (6,) and its covariance (6, 6), by sights and touch together; see `Joint.error`.

        None before anything was seen and touched.
        """
        if self.belief is None or self._last is None or self.sight.mount is None:
            return None
        joint = self.belief.now.touched(self._last.T_palm_object, self._last.information)
        return joint.error, joint.covariance[6:, 6:]

    @property
    def sigma(self) -> float:
        """Standard deviation of the position of the object's middle, its largest [m]; infinite before there is one."""
        if self._last is None:
            return np.inf if self.estimate is None else answers.sigma_position(self.estimate, self.model)
        # What costs is done once for each correction.
        if self._spread is None or self._spread[0] is not self._last:
            self._spread = (self._last, answers.sigma_position(self._last, self.model))
        return float(np.sqrt(self._spread[1] ** 2 + self._walk[0] * (self._now - self._corrected_at)))

    def _judged(self, estimate: PoseEstimate) -> tuple[State, str]:
        """How far the estimate is to be trusted, and why no further."""
        now = self._now
        if self.touch.contacts is not None:
            self._heard_at = now
        if estimate.consistent or self._fits_at == -np.inf:
            self._fits_at = now
        if now - self._heard_at > self.settings.lost_after:
            return "lost", f"nothing touched and nothing seen for {now - self._heard_at:.1f} s"
        if now - self._fits_at > LOST_WITHOUT_FIT:
            return "lost", f"the contacts have fitted no pose for {now - self._fits_at:.1f} s"
        if not estimate.consistent:
            return "uncertain", "the contacts do not fit the object where it is believed to be"
        if self._last is None:
            return "uncertain", "nothing is touched: the pose is vision's"
        sigma = self.sigma
        if sigma > self.settings.uncertain_position:
            return "uncertain", f"the position is known to {1e3 * sigma:.0f} mm only"
        return "tracking", ""
