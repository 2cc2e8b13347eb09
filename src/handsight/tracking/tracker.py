"""The object's pose in the palm over time: propagated between corrections, corrected when there is something new."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from handsight import checks, se3
from handsight._kernels.warm import warm_tracker
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import MOST_SAMPLES, PoseEstimate, PosePrior, correct_pose, refine_pose
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.grasp import ContactMemory, GraspChange, GraspState
from handsight.tracking.measurements import VisionUpdate, on_table
from handsight.tracking.propagation import propagated, sigma_of_point
from handsight.tracking.smoother import PoseBiasSmoother

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"
WIDER = 9.0
"""How much more variance a prior gets where nothing fits: the search then begins from several starts."""
RECOVERY_EVERY = 0.5
"""Seconds between two such searches, and between corrections while nothing fits: each costs a hundred others."""
RETRY_EVERY = 0.1
"""The same when the fingers that touch have changed since."""
RENEW_AFTER = 0.02
"""How old the growth of a propagated covariance may be [s]: a micrometre or so."""
MOST_OUTSIDE = 100_000
"""Points of the hand; each is looked at in each step of a correction."""
LOST_WITHOUT_FIT = 2.0
"""So long contacts may contradict every pose before the object counts as lost [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """When a tracker corrects, how it expects things to move, and when it admits that it does not know.

    The defaults serve a hand that holds still or moves slowly.
    """

    rate: float | None = None
    """Corrections a second while something is touched, whether or not anything changed; None: only when it did."""
    moved: float = 0.001
    """A contact that moved so far in the palm is a new one [m]."""
    turned: float = np.deg2rad(5.0)
    """Or whose normal turned so far [rad]."""
    process_noise_position: float = 0.001
    """Random walk of the object in the palm: one standard deviation per axis after a second [m]; it grows with the root
    of time."""
    process_noise_rotation: float = np.deg2rad(3.0)
    """[rad]; a box between three simulated tips crept by 5 mm and 10° while it was carried for 18 s."""
    regrasp_position: float = 0.005
    """How far it may be pushed when a finger comes or goes, per axis [m]."""
    regrasp_rotation: float = np.deg2rad(3.0)
    """[rad]"""
    memory: float = 5.0
    """How long a contact that was lifted is still believed [s]; 0: not at all."""
    samples: int = 0
    """Above 0: the posterior's mean from so many samples instead of its maximum; 4000 take some 50 ms."""
    outside: int = 0
    """How many points of the hand's other links, none of which can be inside the object, are used; 500 serve well.

    Off by itself because shapes in a hand's file are often larger than the hand. The points need the joints of all
    links; where an observation lacks some, there are none."""
    uncertain_position: float = 0.015
    """Largest standard deviation of the position [m] that counts as tracking."""
    lost_after: float = 10.0
    """How long nothing may be touched and nothing seen [s]."""

    def __post_init__(self) -> None:
        checks.whole(self.samples, "samples", MOST_SAMPLES)
        checks.whole(self.outside, "outside", MOST_OUTSIDE)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """The answer of a correction, and what it was made from."""

    estimate: PoseEstimate
    contacts: Contacts
    """Touched by `fingers` at `stamp` [s]."""
    fingers: tuple[str, ...]
    stamp: float
    variance: float
    """Of the position of the object's middle, its largest [m²]."""


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
        self.stamp = -math.inf
        """Of the last observation [s]."""
        self.fingertips = FingertipContacts((), None, {})
        self.T_world_palm: Array | None = None
        self.smoother: PoseBiasSmoother | None = None
        self.estimate: PoseEstimate | None = None
        self.corrections = self.late = 0
        """How often the pose was corrected, and how many observations came after a later one and were left out."""
        self.vision = VisionUpdate(rig, model)
        self._sensors, self._grasp = FingertipSensors(rig), GraspState()
        frames = [finger.frame for finger in rig.fingers.values()]
        self._surface = rig.hand.surface(s.outside, without=frames) if s.outside else None
        self._process_noise = np.repeat([s.process_noise_position**2, s.process_noise_rotation**2], 3)
        self._regrasp_noise = np.repeat([s.regrasp_position**2, s.regrasp_rotation**2], 3)
        self._memory = ContactMemory(s.memory, self._process_noise)
        self._correction: Correction | None = None
        """The last one since the object was grasped."""
        self._propagated_to = self._measured_at = self._fits_at = self._recovered_at = -math.inf
        if start is not None:
            self.smoother = self.vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))

    def update(self, observation: Observation) -> PoseEstimate | None:
        """The pose in the palm now; None as long as there has been neither a start nor a pose from vision.

        `state` and `reason` say how far to trust it. An observation older than the last one changes nothing and is
        counted in `late`. Raises InvalidInput for what is wrong with the observation itself.
        """
        stamp = observation.stamp
        if type(stamp) is not float or not math.isfinite(stamp):
            stamp = float(checks.finite(observation.stamp, "observation.stamp", ()))
        if stamp < self.stamp:
            self.late += 1
            return self.estimate
        joints = observation.joint_positions
        if self.rig.world_from == "joints" and observation.T_world_palm is None and joints is not None:
            observation = replace(observation, T_world_palm=self.rig.hand.T_world_palm(joints))
        self.fingertips = self._sensors.contacts(observation)
        self._predict(observation.T_world_palm, stamp)
        before, touched = self.smoother, self.fingertips.contacts
        self.smoother = self.vision.update(observation, before, self.T_world_palm)
        vision = self.smoother is not before
        if vision or touched is not None:
            self._measured_at = stamp
        if self.smoother is None:
            return None
        if touched is not None and self._due(touched, vision=vision):
            self._correct(touched, self.smoother, observation, vision=vision)
        last = self._correction
        if self.estimate is None or last is None:  # the smoother's alone: contacts leave every direction open
            now = self.smoother.now
            self.estimate = PoseEstimate.from_gaussian(now.T_palm_object, now.covariance[:6, :6], np.eye(6))
        elif stamp - self._propagated_to > RENEW_AFTER:
            self.estimate = propagated(last.estimate, self._process_noise * (stamp - last.stamp))
            self._propagated_to = stamp
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
        last = self._correction
        if last is not None:
            return math.sqrt(last.variance + self._process_noise[0] * (self.stamp - last.stamp))
        if self.estimate is None:
            return math.inf
        return sigma_of_point(self.estimate, self.model, self.model.center_object)

    def _predict(self, T_world_palm: Array | None, stamp: float) -> None:
        """Propagates the smoother to `stamp`, and through what has become of the grasp since."""
        if self.smoother is not None:
            if not self._grasp.grasped and T_world_palm is not None and self.T_world_palm is not None:
                # Nothing holds it: it stays in the world while the palm goes.
                self.smoother = self.smoother.transformed(se3.inverse(T_world_palm) @ self.T_world_palm)
            if stamp > self.stamp > -math.inf:
                self.smoother = self.smoother.inflated(self._process_noise * (stamp - self.stamp))
        if T_world_palm is not None:
            self.T_world_palm = T_world_palm
        self.stamp, fingers = stamp, self.fingertips.fingers
        self._memory.update(fingers, self.fingertips.contacts, stamp)
        change = self._grasp.update(fingers, stamp)
        if change == "grasped":
            self._memory.only(fingers)
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

    def _due(self, touched: Contacts, *, vision: bool) -> bool:
        """Whether vision or touch has something new to say, or touch has not been asked for long enough."""
        last = self._correction
        if last is None:
            return True
        age, regrasped = self.stamp - last.stamp, self.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (RETRY_EVERY if regrasped else RECOVERY_EVERY)
        if vision or regrasped:
            return True
        if self.settings.rate is not None and age >= 1 / self.settings.rate - 1e-9:
            return True
        shift = np.abs(touched.points_palm - last.contacts.points_palm).max()
        cosine = (touched.normals_palm * last.contacts.normals_palm).sum(axis=1).min()
        return bool(shift > self.settings.moved or cosine < math.cos(self.settings.turned))

    def _correct(
        self, touched: Contacts, smoother: PoseBiasSmoother, observation: Observation, *, vision: bool
    ) -> None:
        """The pose from the smoother's as prior and all contacts, touched or remembered, anew."""
        fingers, now, last = self.fingertips.fingers, self.stamp, self._correction
        contacts, remembered = self._memory.added(fingers, touched, now)
        T, covariance = smoother.solved.T_palm_object, smoother.now.covariance[:6, :6]
        outside, joints = None, observation.joint_positions
        if self._surface is not None and joints is not None and joints.keys() >= set(self._surface.joints):
            outside = self._surface.points_palm(joints)
        samples, prior = self.settings.samples, PosePrior.trusted(T, covariance)
        correct = partial(correct_pose, self.model, contacts, outside=outside, samples=samples)
        near = None if vision or last is None or fingers != last.fingers else last.estimate
        estimate = None
        if near is not None and near.consistent and not near.outliers and not samples:
            # Nothing new asks for another minimum than that answer's own, if it still fits.
            estimate = refine_pose(self.model, contacts, prior, near.T_palm_object, outside)
        if estimate is None:
            estimate = correct(vision=prior)
        if not estimate.consistent and now - self._recovered_at >= RECOVERY_EVERY:
            self._recovered_at = now
            wider = correct(vision=PosePrior.trusted(T, WIDER * covariance))
            if wider.consistent:
                estimate = wider
                more = (WIDER - 1) * np.diag(covariance)
                self.smoother = smoother.restarted(smoother.now.inflated(more))
        for i in estimate.outliers:
            if i >= len(touched):
                self._memory.forget(remembered[i - len(touched)])
        variance = sigma_of_point(estimate, self.model, self.model.center_object) ** 2
        self._correction = Correction(estimate, touched, fingers, now, variance)
        self.estimate, self._propagated_to = estimate, now
        self.corrections += 1

    def _judged(self, estimate: PoseEstimate) -> tuple[State, str]:
        """How far the estimate is to be trusted, and why no further."""
        now = self.stamp
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
