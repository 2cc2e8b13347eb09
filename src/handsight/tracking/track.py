"""One object followed in one hand: propagated between corrections, corrected when there is something new."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import Outside, PoseEstimate, PosePrior, correct_pose, refine_pose
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.grasp import ContactMemory, GraspChange, GraspState
from handsight.tracking.hand_outside import CHECK_EVERY, HandOutside, LinkMargins, Solve
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate, on_table
from handsight.tracking.propagation import Correction, process_variance, sigma_of_point
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import NOTHING, SkinSensors
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.trust import CONTRADICTED, SLIPS, VISION_ALONE, State, TrackStatus
from handsight.tracking.weight_update import WeightUpdate

Correct = Callable[..., PoseEstimate]
NO_POSE = "no pose yet: neither a start nor vision"
WIDER = 9.0
"""How much more variance a prior gets where nothing fits: the search then begins from several starts."""
RECOVERY_EVERY = 0.5
"""Seconds between two such searches, and between corrections while nothing fits: each costs a hundred others."""
RETRY_EVERY = 0.1
"""The same when the fingers that touch have changed since."""
ENOUGH_CONTACTS = 3
"""Of fewer the pose takes up all that they say: nothing is left to tell the joints' offsets from."""
RENEW_AFTER = 0.02
"""How old the growth of a propagated covariance may be [s]: a micrometre or so."""


class Track:
    """What is known of one object in one hand, on a clock that goes on."""

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        start: PosePrior | None,
        settings: TrackerSettings,
        joint_offsets: JointOffsets,
    ) -> None:
        """See `Tracker`."""
        self.rig, self.model, self.settings = rig, model, settings
        self.corrections = 0
        """How often the pose was corrected."""
        self._start, self._sensors, s = start, FingertipSensors(rig), settings
        self._offsets = joint_offsets
        self._learnt_from: Correction | None = None
        """The last correction of the grips that the offsets are by."""
        self._hand, self._margins = HandOutside(rig, model, s.outside), LinkMargins()
        self._process_noise = np.repeat([s.process_noise_position**2, s.process_noise_rotation**2], 3)
        self._regrasp_noise = np.repeat([s.regrasp_position**2, s.regrasp_rotation**2], 3)
        self._begin()

    def _begin(self) -> None:
        """Nothing is known but the start."""
        self.state: State = "lost"
        self.reason = NO_POSE
        self.stamp = -math.inf
        """Of the last observation [s]."""
        self.fingertips = FingertipContacts((), None, {})
        self.T_world_palm: Array | None = None
        self.estimate: PoseEstimate | None = None
        self.processed: Observation | None = None
        """The last one, with what its image says as its vision."""
        self.vision, self._slipping = VisionUpdate(self.rig, self.model), SlipUpdate(self.rig)
        self._images = ImageVision(self.rig, self.model, on=self.settings.images)
        self._grasp, self._memory = GraspState(), ContactMemory(self.settings.memory, self._process_noise)
        self._weight, self._skin = WeightUpdate(self.rig, self.model), SkinSensors(self.rig)
        self.skin = NOTHING
        """What the tactile arrays feel."""
        self._correction: Correction | None = None
        """The last one since the object was grasped."""
        self._trust = TrackStatus(self.settings)
        self._propagated_to = self._recovered_at = self._hand_checked_at = -math.inf
        self.smoother = self._started()

    def _started(self) -> PoseBiasSmoother | None:
        """What is known at first."""
        if (start := self._start) is None:
            return None
        return self.vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))

    def _follow(self, observation: Observation) -> PoseEstimate | None:
        """The pose after an observation that is `checked` and not older than the last; raises InvalidInput midway."""
        joints, stamp = observation.joint_positions, observation.stamp
        if self.rig.world_from == "joints" and observation.T_world_palm is None and joints is not None:
            T = se3.check(
                self.rig.hand.T_world_palm(joints), "observation.joint_positions: palm in the world"
            )
            observation = replace(observation, T_world_palm=T)
        self.fingertips = self._sensors.contacts(observation, self._offsets)
        self.skin = self._skin.observed(observation, touched=self.fingertips.contacts is not None)
        self._predict(observation.T_world_palm, stamp)
        if self.skin.pressed:
            self._weight.weigher.forget("the skin of the hand bears a part of it")
        else:
            self._weight.update(observation, self.fingertips, self._offsets, grasped=self._grasp.grasped)
        before, touched = self.smoother, self.fingertips.contacts
        self.smoother = self._with_vision(observation, before)
        vision = self.smoother is not before
        if self.smoother is not None and not self.smoother.is_near:
            # The palm has gone so far that it is in no hand.
            self.smoother, self._correction, self.estimate = self._started(), None, None
        if vision or touched is not None:
            self._trust = self._trust.measured(stamp)
        if self.smoother is None:
            self.state, self.reason = "lost", NO_POSE
            return None
        if touched is not None and self._due(touched, vision=vision):
            self._correct(touched, self.smoother, observation, vision=vision)
        last = self._correction
        if self.estimate is None or last is None:  # the smoother's alone: contacts leave every direction open
            now = self.smoother.now
            self.estimate = PoseEstimate.from_gaussian(now.T_palm_object, now.covariance[:6, :6], np.eye(6))
        elif stamp - self._propagated_to > RENEW_AFTER:
            self.estimate = last.estimate.inflated(process_variance(self._process_noise, stamp - last.stamp))
            self._propagated_to = stamp
        self._trust = self._trust.answered(stamp, consistent=self.estimate.consistent)
        self.state, self.reason = self._trust.judged(stamp, self.sigma, self._doubt(self.estimate))
        return self.estimate

    @property
    def joint_offsets(self) -> JointOffsets:
        """The joints' constant errors, by all grips so far: for the tracker of the next object in this hand."""
        last = self._correction
        if last is None or last is self._learnt_from or last.by_error is None:
            return self._offsets
        if len(last.contacts) < ENOUGH_CONTACTS or not last.estimate.consistent or last.estimate.outliers:
            return self._offsets
        return self._offsets.after(
            self.model, last.contacts, last.by_error, last.estimate.T_palm_object, last.prior
        )

    @property
    def sigma(self) -> float:
        """Standard deviation of the position of the object's middle, its largest [m]; infinite before there is one."""
        last = self._correction
        if last is not None:
            since = process_variance(self._process_noise, self.stamp - last.stamp)
            return math.sqrt(last.variance + since[0])
        if self.estimate is None:
            return math.inf
        return sigma_of_point(self.estimate, self.model, self.model.center_object)

    def _with_vision(
        self, observation: Observation, smoother: PoseBiasSmoother | None
    ) -> PoseBiasSmoother | None:
        """The smoother after what vision says: of an image that is looked at, else a pose of another's."""
        rides = self.estimate.T_palm_object if self.estimate is not None and self._grasp.grasped else None
        processed = self._images.observe(observation, self.vision.camera_from_palm, rides)
        self.processed = processed.observation
        if processed.hand is not None:
            smoother = self.vision.palm_detected(processed.hand, smoother)
        # What is held has gone with the palm since it was seen, else it stayed in the world.
        T = processed.then.T_world_palm if processed.then is not None and self._grasp.grasped else None
        return self.vision.update(processed.observation, smoother, self.T_world_palm if T is None else T)

    def _predict(self, T_world_palm: Array | None, stamp: float) -> None:
        """Propagates the smoother to `stamp`, and through what has become of the grasp since."""
        if self.smoother is not None:
            if not self._grasp.grasped and T_world_palm is not None and self.T_world_palm is not None:
                # Nothing holds it: it stays in the world while the palm goes.
                self.smoother = self.smoother.transformed(se3.inverse(T_world_palm) @ self.T_world_palm)
            if stamp > self.stamp > -math.inf:
                self.smoother = self.smoother.inflated(
                    process_variance(self._process_noise, stamp - self.stamp)
                )
        if T_world_palm is not None:
            self.T_world_palm = T_world_palm
        self.stamp, fingers = stamp, self.fingertips.fingers
        self._memory.update(fingers, self.fingertips.contacts, stamp)
        change = self._grasp.update(fingers, stamp)
        if change == "grasped":
            self._memory.only(fingers)
        if (smoother := self.smoother) is not None:
            smoother = smoother if change is None else self._regrasped(smoother, change)
            self.smoother = self._slipping.update(stamp, self.fingertips, smoother)
        if self._slipping.now.slipping:
            self._memory.only(fingers)
            self._weight.weigher.forget("the object slips")

    def _regrasped(self, smoother: PoseBiasSmoother, change: GraspChange) -> PoseBiasSmoother:
        """The smoother after fingers came or went, which may have pushed the object."""
        self._offsets, self._learnt_from = self.joint_offsets, self._correction
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
        """Whether vision, touch or a slip has something new to say, or touch has not been asked for long enough."""
        last = self._correction
        if last is None:
            return True
        age, regrasped = self.stamp - last.stamp, self.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (RETRY_EVERY if regrasped else RECOVERY_EVERY)
        news = self._weight.news or self.skin.news(last.skin) or self._slipping.asks(last.stamp)
        if vision or regrasped or news:
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
        joints, skin = observation.joint_positions, self.skin
        outside = self._hand.at(joints and self._offsets.corrected(joints), self._margins)
        pressed = skin.contacts()
        contacts = contacts if pressed is None else contacts.joined(pressed)
        samples, prior = self.settings.samples, smoother.without_touch
        given: dict[str, Any] = {"outside": skin.beside(outside), "weight": self._weight.evidence()}
        given["answer"] = self.settings.answer
        correct = partial(correct_pose, self.model, contacts, samples=samples, **given)
        # What vision says anew is little beside an array that is pressed, whose search takes long.
        vision_alone = vision and pressed is None
        near = None if vision_alone or last is None or fingers != last.fingers else last.estimate
        estimate = None
        if near is not None and near.consistent and not near.outliers and not samples:
            # Nothing new asks for another minimum than that answer's own, if it still fits.
            estimate = refine_pose(self.model, contacts, prior, near.T_palm_object_maximum, **given)
        if estimate is None:
            estimate = correct(vision=prior)
        if outside is not None:
            estimate = self._reconciled(
                estimate, outside, lambda hand: correct(vision=prior, outside=skin.beside(hand))
            )
        if not estimate.consistent and now - self._recovered_at >= RECOVERY_EVERY:
            self._recovered_at = now
            estimate, smoother = self._recovered(estimate, smoother, correct)
            self.smoother, prior = smoother, smoother.without_touch
        sensed = None if remembered or pressed is not None else self.fingertips
        estimate = self._weight.shared(estimate, sensed, prior, self._offsets)
        for i in estimate.outliers:
            if len(touched) <= i < len(touched) + len(remembered):
                self._memory.forget(remembered[i - len(touched)])
        variance = sigma_of_point(estimate, self.model, self.model.center_object) ** 2
        self._correction = Correction(
            estimate, touched, self.fingertips.by_error, prior, fingers, now, variance, skin
        )
        self.estimate, self._propagated_to = estimate, now
        self.corrections += 1

    def _recovered(
        self, estimate: PoseEstimate, smoother: PoseBiasSmoother, correct: Correct
    ) -> tuple[PoseEstimate, PoseBiasSmoother]:
        """Another estimate, where contacts fit one: by a wider prior; lost, by what vision alone says last."""
        now = smoother.now
        wider = smoother.restarted(now.inflated((WIDER - 1) * now.covariance.diagonal()[:6]))
        # Touch may have said where something else is, such as the edge of the table.
        for other in (wider, self.vision.afresh() if self._trust.unfitted(self.stamp) else None):
            found = estimate if other is None else correct(vision=other.without_touch)
            if other is not None and found.consistent:
                return found, other
        return estimate, smoother

    def _reconciled(self, estimate: PoseEstimate, outside: Outside, solve: Solve) -> PoseEstimate:
        """The estimate where links of the hand that are larger in their file than they are have been found."""
        fits = estimate.consistent and not estimate.outliers
        if fits and self.stamp - self._hand_checked_at < CHECK_EVERY:
            return estimate
        self._hand_checked_at = self.stamp
        estimate, inside = self._hand.reconciled(estimate, outside, solve)
        self._margins = self._margins.noted(inside, self.stamp)
        return estimate

    def _doubt(self, estimate: PoseEstimate) -> str:
        """What speaks against an answer; empty: nothing."""
        if self._slipping.now.slipping:
            return SLIPS
        if not estimate.consistent:
            return CONTRADICTED
        by_vision = self._correction is None and not self.vision.camera_from_palm.believed
        return VISION_ALONE if by_vision else ""
