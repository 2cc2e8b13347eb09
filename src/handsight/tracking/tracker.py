"""The object's pose in the palm over time: propagated between corrections, corrected when there is something new."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from handsight import checks, se3
from handsight._kernels.warm import warm_tracker
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior, correct_pose, refine_pose
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.contact_memory import ContactMemory, with_remembered
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.grasp_state import GraspChange, GraspState
from handsight.tracking.propagation import Correction, estimate_without_contacts, sigma_of_point
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.table import on_table
from handsight.tracking.vision_update import VisionUpdate

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"
WIDER = 9.0
"""How much more variance a prior gets where nothing fits: the search then begins from several starts."""
RECOVERY_EVERY = 0.5
"""Seconds between two such searches, and between corrections while nothing fits: each costs a hundred others."""
RETRY_EVERY = 0.1
"""The same when the fingers that touch have changed since."""
LOST_WITHOUT_FIT = 2.0
"""So long contacts may contradict every pose before the object counts as lost [s]."""


class Tracker:
    """One object in one hand. Give it every observation; it answers with the pose at each.

    The object is fixed in the palm between corrections (the paper's assumption), its uncertainty growing; while it is
    not grasped, it is fixed in the world. It is corrected when a finger touches or lets go, when a contact has moved,
    when vision arrives, or at a set rate.
    """

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        start: PosePrior | None = None,
        settings: TrackerSettings | None = None,
    ) -> None:
        """`start`: where the object is in the palm at first, if the user knows; else vision's first pose starts."""
        if not isinstance(rig, Rig) or not isinstance(model, ObjectModel):
            came = f"{type(rig).__name__} and {type(model).__name__}"
            raise InvalidInput(f"tracker: expected a Rig and an ObjectModel, got {came}")
        warm_tracker()
        self.rig, self.model = rig, model
        self.settings = s = settings or TrackerSettings()
        self.state: State = "lost"
        self.reason = NO_POSE
        self.stamp: float | None = None
        self.fingertips = FingertipContacts((), None, {})
        self.T_world_palm: Array | None = None
        self.smoother: PoseBiasSmoother | None = None
        self.estimate: PoseEstimate | None = None
        self.corrections = self.late = 0
        """How often the pose was corrected, and how many observations came after a later one and were left out."""
        self.vision = VisionUpdate(rig, model)
        self._sensors, self._memory, self._grasp = (
            FingertipSensors(rig),
            ContactMemory(s.memory),
            GraspState(),
        )
        self._surface = rig.hand.surface(s.outside, without=self._sensors.frames) if s.outside else None
        self._surface_joints = frozenset(self._surface.joints) if self._surface else frozenset()
        self._process_noise = np.repeat([s.process_noise_position**2, s.process_noise_rotation**2], 3)
        self._regrasp_noise = np.repeat([s.regrasp_position**2, s.regrasp_rotation**2], 3)
        self._cosine_turned = math.cos(s.turned)
        self._middle_object = model.center_object
        self._correction: Correction | None = None
        """The last one since the object was grasped."""
        self._now = self._measured_at = self._fits_at = self._recovered_at = -math.inf
        if start is not None:
            self.smoother = self.vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))

    def update(self, observation: Observation) -> PoseEstimate | None:
        """The pose in the palm now; None as long as there has been neither a start nor a pose from vision.

        `state` and `reason` say how far to trust it. An observation older than the last one changes nothing and is
        counted in `late`. Raises InvalidInput for what is wrong with the observation itself.
        """
        stamp = observation.stamp
        if type(stamp) is not float or not math.isfinite(stamp):
            stamp = float(checks.finite(stamp, "observation.stamp", ()))
        if stamp < self._now:
            self.late += 1
            return self.estimate
        observation = self._with_palm(observation)
        self.fingertips = self._sensors.contacts(observation)
        self._predict(observation.T_world_palm, stamp)
        vision = self._update_by_vision(observation)
        if self.smoother is None:
            return None
        if self._due(vision=vision):
            self._correct(self.smoother, observation, vision=vision)
        self.estimate = self._propagated(self.smoother)
        self.state, self.reason = self._judged(self.estimate)
        return self.estimate

    def vision_bias(self) -> tuple[Array, Array] | None:
        """Vision's constant bias (6,) and its covariance (6, 6), by vision and contacts together.

        See `PoseAndBias.vision_bias`. None before there were both.
        """
        if self.smoother is None or self._correction is None or self.vision.mount is None:
            return None
        estimate = self._correction.estimate
        state = self.smoother.now.given_pose(estimate.T_palm_object, estimate.information)
        return state.vision_bias, state.covariance[6:, 6:]

    @property
    def sigma(self) -> float:
        """Standard deviation of the position of the object's middle, its largest [m]; infinite before there is one."""
        if self._correction is not None:
            return self._correction.sigma_of_point(self._now, self.model, self._middle_object)
        if self.estimate is None:
            return math.inf
        return sigma_of_point(self.estimate, self.model, self._middle_object)

    def _with_palm(self, observation: Observation) -> Observation:
        """The observation with the palm's pose in the world, by the arm in the hand's file if the rig says so."""
        joints = observation.joint_positions
        if self.rig.world_from != "joints" or observation.T_world_palm is not None or joints is None:
            return observation
        return replace(observation, T_world_palm=self.rig.hand.T_world_palm(joints))

    def _predict(self, T_world_palm: Array | None, stamp: float) -> None:
        """Propagates the smoother to `stamp`, and through what has become of the grasp since."""
        if self.smoother is not None:
            if not self._grasp.grasped and T_world_palm is not None and self.T_world_palm is not None:
                # Nothing holds it: it stays in the world while the palm goes.
                self.smoother = self.smoother.transformed(se3.inverse(T_world_palm) @ self.T_world_palm)
            if stamp > self._now > -math.inf:
                self.smoother = self.smoother.inflated(self._process_noise * (stamp - self._now))
        if T_world_palm is not None:
            self.T_world_palm = T_world_palm
        self.stamp = self._now = stamp
        self._memory.update(self.fingertips, stamp)
        change = self._grasp.update(self.fingertips.fingers, stamp)
        if change == "grasped":
            self._memory.only(self.fingertips.fingers)
        if self.smoother is not None and change is not None:
            self.smoother = self._regrasped(self.smoother, change)

    def _regrasped(self, smoother: PoseBiasSmoother, change: GraspChange) -> PoseBiasSmoother:
        """The smoother after fingers came or went, which may have pushed the object."""
        state, T, table = smoother.now, self.T_world_palm, self.rig.table
        if change == "released":
            # What contacts have said outlives the grasp, but not where the object is in the palm from now on.
            if self._correction is not None:
                estimate = self._correction.estimate
                state = state.given_pose(estimate.T_palm_object, estimate.information)
            self._correction = None
            return smoother.restarted(state.inflated(self._regrasp_noise))
        state = state.inflated(self._regrasp_noise)
        if table is not None and T is not None and self._grasp.on_table(float(T[2, 3])):
            state = on_table(state, self.model, table, T) or state
        return smoother.restarted(state)

    def _update_by_vision(self, observation: Observation) -> bool:
        """Gives the smoother what vision measured; whether there was anything."""
        before = self.smoother
        self.smoother = self.vision.update(observation, before, self.T_world_palm)
        if self.smoother is before:
            return False
        self._measured_at = self._now
        return True

    def _due(self, *, vision: bool) -> bool:
        """Whether vision or touch has something new to say, or touch has not been asked for long enough."""
        now, last = self.fingertips.contacts, self._correction
        if now is None:
            return False
        if last is None:
            return True
        age, regrasped = self._now - last.stamp, self.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (RETRY_EVERY if regrasped else RECOVERY_EVERY)
        if vision or regrasped:
            return True
        if self.settings.rate is not None and age >= 1 / self.settings.rate - 1e-9:
            return True
        then = last.contacts
        shift = np.abs(now.points_palm - then.points_palm).max()
        cosine = np.einsum("ij,ij->i", now.normals_palm, then.normals_palm).min()
        return bool(shift > self.settings.moved or cosine < self._cosine_turned)

    def _correct(self, smoother: PoseBiasSmoother, observation: Observation, *, vision: bool) -> None:
        """The pose from the smoother's as prior and all contacts, touched or remembered, anew."""
        touched, last = self.fingertips, self._correction
        remembered = self._memory.of_others(touched)
        contacts = with_remembered(touched, remembered, self._process_noise, self._now)
        if contacts is None or touched.contacts is None:
            return
        T, covariance = smoother.solved.T_palm_object, smoother.now.covariance[:6, :6]
        near = None if vision or last is None or touched.fingers != last.fingers else last.estimate
        outside = self._outside_points(observation)
        estimate = self._solved(contacts, PosePrior.trusted(T, covariance), outside, near)
        if not estimate.consistent and self._now - self._recovered_at >= RECOVERY_EVERY:
            self._recovered_at = self._now
            wider = self._solved(contacts, PosePrior.trusted(T, WIDER * covariance), outside)
            if wider.consistent:
                estimate = wider
                more = (WIDER - 1) * np.diag(covariance)
                self.smoother = smoother.restarted(smoother.now.inflated(more))
        for i in estimate.outliers:
            if i >= len(touched.contacts):
                self._memory.forget(remembered[i - len(touched.contacts)].finger)
        self._correction = Correction(
            estimate, touched.contacts, touched.fingers, self._now, self._process_noise
        )
        self.corrections += 1

    def _solved(
        self, contacts: Contacts, prior: PosePrior, outside: Array | None, near: PoseEstimate | None = None
    ) -> PoseEstimate:
        """The answer; with `near`, that estimate's own minimum if it still fits: nothing new asks for another."""
        samples = self.settings.samples
        if near is not None and near.consistent and not near.outliers and not samples:
            refined = refine_pose(self.model, contacts, prior, near.T_palm_object, outside)
            if refined is not None:
                return refined
        return correct_pose(self.model, contacts, vision=prior, outside=outside, samples=samples)

    def _outside_points(self, observation: Observation) -> Array | None:
        """(m, 3) points of the hand in the palm [m]; None where none are asked for or joints are missing."""
        joints = observation.joint_positions
        if self._surface is None or joints is None or not self._surface_joints <= joints.keys():
            return None
        return self._surface.points_palm(joints)

    def _propagated(self, smoother: PoseBiasSmoother) -> PoseEstimate:
        """The last correction as it stands now; without one, the smoother's pose."""
        if self._correction is not None:
            return self._correction.at(self._now)
        state = smoother.now
        return estimate_without_contacts(state.T_palm_object, state.covariance[:6, :6])

    def _judged(self, estimate: PoseEstimate) -> tuple[State, str]:
        """How far the estimate is to be trusted, and why no further."""
        now = self._now
        if self.fingertips.contacts is not None:
            self._measured_at = now
        if estimate.consistent or self._fits_at == -math.inf:
            self._fits_at = now
        if now - self._measured_at > self.settings.lost_after:
            return "lost", f"nothing touched and nothing seen for {now - self._measured_at:.1f} s"
        if now - self._fits_at > LOST_WITHOUT_FIT:
            return "lost", f"the contacts have fitted no pose for {now - self._fits_at:.1f} s"
        if not estimate.consistent:
            return "uncertain", "the contacts do not fit the object where it is believed to be"
        if self._correction is None:
            return "uncertain", "nothing is touched: the pose is vision's"
        sigma = self.sigma
        if sigma > self.settings.uncertain_position:
            return "uncertain", f"the position is known to {1e3 * sigma:.0f} mm only"
        return "tracking", ""
