"""One object followed in one hand: propagated between corrections, corrected when there is something new."""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.copies import shallow_copy
from handsight.correction import Outside, PoseEstimate, PosePrior, correct_pose, refine_pose
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.grasp import ContactMemory, GraspChange, GraspState
from handsight.tracking.hand_outside import HAND_OUTSIDE, HandOutside, LinkMargins, Solve
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate, on_table
from handsight.tracking.propagation import Correction, process_variance, sigma_of_point
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinContacts, SkinSensors
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.status import CONTRADICTED, SLIPS, VISION_ALONE, State, TrackStatus
from handsight.tracking.track_state import NO_POSE, TrackState
from handsight.tracking.weight_update import WeightUpdate

Correct = Callable[..., PoseEstimate]


class FollowerOptions(NamedTuple):
    """`FollowerOptions` say when a lost fit is searched for again."""

    inflation: float = 9.0
    """How much more variance a prior gets where nothing fits: the search then starts from several poses."""
    recovery_period: float = 0.5
    """Between two such searches, and between corrections while nothing fits: each costs a hundred others [s]."""
    retry_period: float = 0.1  # the same when the fingers that touch have changed since [s]
    min_contacts_to_learn: int = 3
    """Of fewer contacts the pose takes up all that they say: nothing is left to learn the joints' offsets from."""
    renew_after: float = 0.02  # how old the growth of a propagated covariance may be [s]: a micrometre or so


FOLLOWER = FollowerOptions()


class Follower:
    """Follows one object in one hand; it knows the robot, the object and the settings, and nothing that changes."""

    def __init__(self, rig: Rig, model: ObjectModel, settings: TrackerSettings) -> None:
        """See `Tracker`."""
        self.rig, self.model, self.settings, s = rig, model, settings, settings
        self.sensors = FingertipSensors(rig)
        self.hand = HandOutside(rig, model, s.outside)
        self.process_noise = np.repeat([s.process_noise_position**2, s.process_noise_rotation**2], 3)
        """(6,) variance of the object's motion in the palm, per second."""
        self.regrasp_noise = np.repeat([s.regrasp_position**2, s.regrasp_rotation**2], 3)
        """(6,) variance of how far the object moves when fingers come or go."""

    def initial(self, start: PosePrior | None, offsets: JointOffsets) -> TrackState:
        """Returns the state before any observation; `start`: where the object is at first, if that is known."""
        vision = VisionUpdate(self.rig, self.model)
        smoother = None
        if start is not None:
            smoother = vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))
        return TrackState(
            start=start,
            smoother=smoother,
            status=TrackStatus(self.settings),
            grasp=GraspState(),
            memory=ContactMemory(self.settings.memory, self.process_noise),
            vision=vision,
            images=ImageVision(self.rig, self.model, on=self.settings.images),
            slip=SlipUpdate(self.rig),
            weight=WeightUpdate(self.rig, self.model),
            skin_sensors=SkinSensors(self.rig),
            offsets=offsets,
        )

    def step(self, state: TrackState, observation: Observation) -> tuple[TrackState, PoseEstimate | None]:
        """Returns the state after an observation, and the object's pose in the palm, None before there is one.

        It is pure: the same state and observation give the same answer, and the state is not changed. The observation
        is one that was checked (`handsight.observation.checked`) and is not older than the state's. Raises
        InvalidInput where something in the observation is wrong.
        """
        work = _Step(self, state)
        estimate = work.follow(observation)
        return work.state(), estimate

    def sigma(self, state: "TrackState | _Step") -> float:
        """Returns the largest standard deviation of the position of the object's middle [m]; infinite before a pose."""
        last = state.correction
        if last is not None:
            since = process_variance(self.process_noise, state.stamp - last.stamp)
            return math.sqrt(last.variance + since[0])
        if state.estimate is None:
            return math.inf
        return sigma_of_point(state.estimate, self.model, self.model.center_object)

    def joint_offsets(self, state: "TrackState | _Step") -> JointOffsets:
        """Returns the joints' constant errors by all grips so far, this one included."""
        last = state.correction
        if last is None or last is state.learnt_from or last.by_error is None:
            return state.offsets
        if (
            len(last.contacts) < FOLLOWER.min_contacts_to_learn
            or not last.estimate.consistent
            or last.estimate.outliers
        ):
            return state.offsets
        return state.offsets.after(
            self.model, last.contacts, last.by_error, last.estimate.T_palm_object, last.prior
        )


FIELDS = tuple(field.name for field in fields(TrackState))


class _Step:
    """A `_Step` is one step on its way: it begins with all of a state's fields, each of which it may bind anew."""

    stamp: float
    label: State
    reason: str
    estimate: PoseEstimate | None
    corrections: int
    T_world_palm: Array | None
    fingertips: FingertipContacts
    skin: SkinContacts
    processed: Observation | None
    smoother: PoseBiasSmoother | None
    correction: Correction | None
    status: TrackStatus
    offsets: JointOffsets
    learnt_from: Correction | None
    margins: LinkMargins
    propagated_to: float
    recovered_at: float
    links_checked_at: float
    start: PosePrior | None

    def __init__(self, follower: Follower, state: TrackState) -> None:
        self.follower = follower
        self.rig, self.model, self.settings = follower.rig, follower.model, follower.settings
        values = vars(self)
        values.update(vars(state))
        # These change when they are told something; the state keeps them as they were.
        self.grasp, self.memory = shallow_copy(state.grasp), shallow_copy(state.memory)
        self.vision, self.skin_sensors = shallow_copy(state.vision), shallow_copy(state.skin_sensors)
        self.images, self.slip, self.weight = (
            state.images.copied(),
            state.slip.copied(),
            state.weight.copied(),
        )

    def state(self) -> TrackState:
        """Returns the state that the step has led to."""
        values, state = vars(self), object.__new__(TrackState)
        # At each observation: a frozen dataclass sets its fields one by one, in three times as long.
        vars(state).update({name: values[name] for name in FIELDS})
        return state

    def follow(self, observation: Observation) -> PoseEstimate | None:
        """Returns the pose after an observation, see `Follower.step`."""
        joints, stamp = observation.joint_positions, observation.stamp
        if self.rig.world_from == "joints" and observation.T_world_palm is None and joints is not None:
            T = se3.check(
                self.rig.hand.T_world_palm(joints), "observation.joint_positions: palm in the world"
            )
            observation = replace(observation, T_world_palm=T)
        self.fingertips = self.follower.sensors.contacts(observation, self.offsets)
        self.skin = self.skin_sensors.observed(observation, touched=self.fingertips.contacts is not None)
        self._predict(observation.T_world_palm, stamp)
        if self.skin.pressed:
            self.weight.weigher.forget("the skin of the hand bears a part of it")
        else:
            self.weight.update(observation, self.fingertips, self.offsets, grasped=self.grasp.grasped)
        before, touched = self.smoother, self.fingertips.contacts
        self.smoother = self._with_vision(observation, before)
        vision = self.smoother is not before
        if self.smoother is not None and not self.smoother.is_near:
            # The palm has gone so far that it is in no hand.
            self.smoother, self.correction, self.estimate = self._restarted(), None, None
        if vision or touched is not None:
            self.status = self.status.measured(stamp)
        if self.smoother is None:
            self.label, self.reason = "lost", NO_POSE
            return None
        if touched is not None and self._due(touched, vision=vision):
            self._correct(touched, self.smoother, observation, vision=vision)
        last = self.correction
        if self.estimate is None or last is None:  # the smoother's alone: contacts leave every direction open
            now = self.smoother.now
            self.estimate = PoseEstimate.from_gaussian(now.T_palm_object, now.covariance[:6, :6], np.eye(6))
        elif stamp - self.propagated_to > FOLLOWER.renew_after:
            self.estimate = last.estimate.inflated(
                process_variance(self.follower.process_noise, stamp - last.stamp)
            )
            self.propagated_to = stamp
        self.status = self.status.answered(stamp, consistent=self.estimate.consistent)
        sigma = self.follower.sigma(self)
        self.label, self.reason = self.status.judged(stamp, sigma, self._doubt(self.estimate))
        return self.estimate

    def _restarted(self) -> PoseBiasSmoother | None:
        """Returns what is known of the pose from the start alone."""
        if (start := self.start) is None:
            return None
        return self.vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))

    def _with_vision(
        self, observation: Observation, smoother: PoseBiasSmoother | None
    ) -> PoseBiasSmoother | None:
        """Returns the smoother after what vision says: of an image that is looked at, else a pose of another's."""
        rides = self.estimate.T_palm_object if self.estimate is not None and self.grasp.grasped else None
        processed = self.images.observe(observation, self.vision.camera_from_palm, rides)
        self.processed = processed.observation
        if processed.hand is not None:
            smoother = self.vision.palm_detected(processed.hand, smoother)
        # What is held has gone with the palm since it was seen, else it stayed in the world.
        T = processed.then.T_world_palm if processed.then is not None and self.grasp.grasped else None
        return self.vision.update(processed.observation, smoother, self.T_world_palm if T is None else T)

    def _predict(self, T_world_palm: Array | None, stamp: float) -> None:
        """Propagates the smoother to `stamp`, and through what has become of the grasp since."""
        if self.smoother is not None:
            if not self.grasp.grasped and T_world_palm is not None and self.T_world_palm is not None:
                # Nothing holds it: it stays in the world while the palm goes.
                self.smoother = self.smoother.transformed(se3.inverse(T_world_palm) @ self.T_world_palm)
            if stamp > self.stamp > -math.inf:
                self.smoother = self.smoother.inflated(
                    process_variance(self.follower.process_noise, stamp - self.stamp)
                )
        if T_world_palm is not None:
            self.T_world_palm = T_world_palm
        self.stamp, fingers = stamp, self.fingertips.fingers
        self.memory.update(fingers, self.fingertips.contacts, stamp)
        change = self.grasp.update(fingers, stamp)
        if change == "grasped":
            self.memory.only(fingers)
        if (smoother := self.smoother) is not None:
            smoother = smoother if change is None else self._regrasped(smoother, change)
            self.smoother = self.slip.update(stamp, self.fingertips, smoother)
        if self.slip.now.slipping:
            self.memory.only(fingers)
            self.weight.weigher.forget("the object slips")

    def _regrasped(self, smoother: PoseBiasSmoother, change: GraspChange) -> PoseBiasSmoother:
        """Returns the smoother after fingers came or went, which may have pushed the object."""
        self.offsets = self.follower.joint_offsets(self)
        self.learnt_from = self.correction
        state, T, table = smoother.now, self.T_world_palm, self.rig.table
        if change == "released":
            # What contacts have said outlives the grasp, but not where the object is in the palm from now on.
            if self.correction is not None:
                estimate = self.correction.estimate
                state = state.given_pose(estimate.T_palm_object, estimate.information)
            self.correction = None
            return smoother.restarted(state.inflated(self.follower.regrasp_noise))
        state = state.inflated(self.follower.regrasp_noise)
        if table is not None and T is not None and self.grasp.on_table(float(T[2, 3])):
            state = on_table(state, self.model, table, T) or state
        return smoother.restarted(state)

    def _due(self, touched: Contacts, *, vision: bool) -> bool:
        """Returns whether vision, touch or a slip has something new to say, or touch has not been asked for long
        enough."""
        last = self.correction
        if last is None:
            return True
        age, regrasped = self.stamp - last.stamp, self.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (FOLLOWER.retry_period if regrasped else FOLLOWER.recovery_period)
        news = self.weight.news or self.skin.news(last.skin) or self.slip.asks(last.stamp)
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
        """Returns the pose from the smoother's as prior and all contacts, touched or remembered, anew."""
        fingers, now, last = self.fingertips.fingers, self.stamp, self.correction
        contacts, remembered = self.memory.added(fingers, touched, now)
        joints, skin = observation.joint_positions, self.skin
        outside = self.follower.hand.at(joints and self.offsets.corrected(joints), self.margins)
        pressed = skin.evidence()
        samples, prior = self.settings.samples, smoother.without_touch
        given: dict[str, Any] = {"outside": outside, "weight": self.weight.evidence(), "skin": pressed}
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
            estimate = self._reconciled(estimate, outside, lambda hand: correct(vision=prior, outside=hand))
        if not estimate.consistent and now - self.recovered_at >= FOLLOWER.recovery_period:
            self.recovered_at = now
            estimate, smoother = self._recovered(estimate, smoother, correct)
            self.smoother, prior = smoother, smoother.without_touch
        sensed = None if remembered or pressed is not None else self.fingertips
        estimate = self.weight.shared(estimate, sensed, prior, self.offsets)
        for i in estimate.outliers:
            if len(touched) <= i < len(touched) + len(remembered):
                self.memory.forget(remembered[i - len(touched)])
        variance = sigma_of_point(estimate, self.model, self.model.center_object) ** 2
        self.correction = Correction(
            estimate, touched, self.fingertips.by_error, prior, fingers, now, variance, skin
        )
        self.estimate, self.propagated_to = estimate, now
        self.corrections += 1

    def _recovered(
        self, estimate: PoseEstimate, smoother: PoseBiasSmoother, correct: Correct
    ) -> tuple[PoseEstimate, PoseBiasSmoother]:
        """Returns another estimate, where contacts fit one: by a wider prior; lost, by what vision alone says last."""
        now = smoother.now
        wider = smoother.restarted(now.inflated((FOLLOWER.inflation - 1) * now.covariance.diagonal()[:6]))
        # Touch may have said where something else is, such as the edge of the table.
        for other in (wider, self.vision.afresh() if self.status.unfitted(self.stamp) else None):
            found = estimate if other is None else correct(vision=other.without_touch)
            if other is not None and found.consistent:
                return found, other
        return estimate, smoother

    def _reconciled(self, estimate: PoseEstimate, outside: Outside, solve: Solve) -> PoseEstimate:
        """Returns the estimate where links of the hand that are larger in their file than they are have been found."""
        fits = estimate.consistent and not estimate.outliers
        if fits and self.stamp - self.links_checked_at < HAND_OUTSIDE.check_period:
            return estimate
        self.links_checked_at = self.stamp
        estimate, inside = self.follower.hand.reconciled(estimate, outside, solve)
        self.margins = self.margins.noted(inside, self.stamp)
        return estimate

    def _doubt(self, estimate: PoseEstimate) -> str:
        """Returns what speaks against an answer; empty: nothing."""
        if self.slip.now.slipping:
            return SLIPS
        if not estimate.consistent:
            return CONTRADICTED
        by_vision = self.correction is None and not self.vision.camera_from_palm.believed
        return VISION_ALONE if by_vision else ""
