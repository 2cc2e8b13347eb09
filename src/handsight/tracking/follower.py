"""One object followed in one hand: from the state after one observation to the state after the next."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact.kernels.contacts_to_palm import have_moved
from handsight.correction import PoseEstimate, PosePrior, refine_pose
from handsight.correction.correct import problem_of
from handsight.correction.estimate import point_uncertainty
from handsight.errors import InvalidInput
from handsight.forces import WeightSensor
from handsight.objects import ObjectModel
from handsight.objects.resting import resting_poses
from handsight.observation import Observation, seconds
from handsight.rig import MountedCamera, Rig
from handsight.tracking.answer import Correction
from handsight.tracking.belief import Belief
from handsight.tracking.concurrent_images import ConcurrentImages
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.grasp import ContactMemory, GraspChange, slid
from handsight.tracking.hand_outside import HandOutside
from handsight.tracking.hypotheses import RELEVANT_WEIGHT, among_rivals, with_others, with_rivals
from handsight.tracking.images import ImageVision, ObjectInImages
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.judge import CONFIRM_AFTER, accepted, held, judged
from handsight.tracking.measurements import EYE
from handsight.tracking.misfit import Innovations
from handsight.tracking.monitor import NO_POSE, Failure
from handsight.tracking.search import Solver, Unfinished, solves_in
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinSensors
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import STILL, process_variance
from handsight.tracking.table import TableEstimate, TableEvidence, supports_of
from handsight.tracking.track_state import Search, Touch, TrackState
from handsight.vision import FirstPoseSource, locate

INFLATION = 9
"""Factor on the prior's variance when contacts fit no pose near it: the search then starts from several poses."""
RECOVERY_PERIOD = 0.5
"""Time between two such searches, and between corrections while something is rejected: each costs as much as a hundred
others [s]."""
SEARCH_PERIOD = 3  # between two searches for other modes, where vision brings none about [s]
RETRY_PERIOD = 0.1  # time between corrections while nothing fits, if other fingers touch now [s]
MIN_CONTACTS_TO_LEARN = 3
"""The joints' offsets are learnt from so many contacts or more: fewer determine the pose alone."""
LEAST_HOLD = 0.05
"""How long fingers must have held an object for what they have told of its pose to stay once it is released [s]: a
contact of one reading may be noise."""
MOVED = 0.001
TURNED = float(np.deg2rad(5))
"""The pose is corrected when a contact has moved by so much in the palm [m], or its normal by so much [rad]."""


Remedy = Callable[[Belief], Belief]
"""What is done to a belief under which contacts fit no pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a correction has found; it changes the state of the observation by which the correction ends."""

    correction: Correction
    innovations: Innovations
    """How well evidence has fitted."""
    table: TableEvidence | None
    """The table's evidence, after the supports were compared, if they were."""
    remedy: Remedy | None = None
    """What is done to a belief that fits no contacts; None: nothing."""
    wrong: tuple[str, ...] = ()
    """Fingers whose remembered contacts contradict the rest."""


class Follower:
    """Makes the next state of a track; it holds the robot, the object and the settings, but no state."""

    def __init__(
        self, rig: Rig, model: ObjectModel, settings: TrackerSettings, source: FirstPoseSource = locate
    ) -> None:
        """The arguments are those of `Tracker`."""
        self.source = source
        self.rig = rig
        self.model = model
        self.settings = settings
        self.camera = rig.camera or MountedCamera()
        self.sensors = FingertipSensors(rig)
        self.skin_sensors = SkinSensors(rig)
        self.hand = HandOutside(rig, model, settings.outside)
        sigmas = np.array([settings.process_noise_position, settings.process_noise_rotation])
        self.process_noise = np.repeat(sigmas**2, 3)
        """(6,) variance of the object's random walk in the palm, per second [m², rad²]."""
        poses = () if rig.table is None else resting_poses(model, model.center_of_mass)
        self.supports = supports_of(poses)
        """What may bear the object while it is on the table."""

    def initial(self, start: PosePrior | None, offsets: JointOffsets) -> TrackState:
        """Returns the state before any observation; `start`: the object's pose in the palm, None where unknown."""
        follow = ConcurrentImages if self.settings.concurrent_images else ObjectInImages
        return TrackState(
            belief=Belief.initial(self.rig, self.model, start, self.process_noise),
            images=ImageVision(self.rig, self.model, self.source, on=self.settings.images, follow=follow),
            touch=Touch(ContactMemory(self.settings.memory, self.process_noise)),
            slip=SlipUpdate(self.rig, self.model),
            weight=WeightSensor(self.rig, self.model),
            offsets=offsets,
        )

    def step(self, state: TrackState, observation: Observation) -> tuple[TrackState, PoseEstimate | None]:
        """Returns the state after an observation, and the object's pose in the palm, None before there is one.

        It is pure: the same state and observation give the same answer, and the state is not changed. The observation
        must have been checked (`handsight.observation.check_observation`), and its stamp must not be older than the
        state's. Raises InvalidInput where something in the observation is wrong.
        """
        observation = self._placed(observation)
        elapsed = seconds(observation.stamp, state.stamp)
        state = self._touched(state, observation)
        state = self._predicted(state, observation)
        state = self._weighed(state, observation)
        state = self._seen(state, observation)
        if state.belief.smoother is None:
            monitor = replace(state.monitor, label="lost", reason=NO_POSE)
            return replace(state, estimate=None, monitor=monitor), None
        state = self._corrected(state, elapsed)
        estimate = self._propagated(state)
        monitor = judged(self.model, state, estimate, self.settings)
        return replace(state, estimate=estimate, monitor=monitor), estimate

    def table(self, state: TrackState) -> TableEstimate | None:
        """Returns where the table must be, given the object's pose; None before the object was grasped on it."""
        table = state.belief.table
        if table is None or state.estimate is None:
            return None
        return table.estimated(state.estimate, self._drift(table, state.stamp))

    def joint_offsets(self, state: TrackState) -> JointOffsets:
        """Returns the joints' constant errors, learnt from all grips so far, this one included."""
        last = state.correction
        if last is None or last is state.learnt_from or last.by_error is None:
            return state.offsets
        few = len(last.contacts) < MIN_CONTACTS_TO_LEARN
        if few or not last.estimate.consistent or last.estimate.outliers:
            return state.offsets
        return state.offsets.after(
            self.model, last.contacts, last.by_error, last.estimate.T_palm_object, last.prior
        )

    def _drift(self, table: TableEvidence, stamp: float) -> Array:
        """Returns the variance (6,) of the object's random walk since it was on the table [m², rad²]."""
        return process_variance(self.process_noise, seconds(stamp, table.stamp))

    def _placed(self, observation: Observation) -> Observation:
        """Returns the observation with the palm's pose, where the rig's joints tell it."""
        joints = observation.joint_positions
        known = observation.T_world_palm is not None or joints is None
        if self.rig.world_from != "joints" or known or joints is None:
            return observation
        T = se3.check(self.rig.hand.T_world_palm(joints), "observation.joint_positions: palm in the world")
        return replace(observation, T_world_palm=T)

    def _touched(self, state: TrackState, observation: Observation) -> TrackState:
        """Returns the state with the contacts of an observation."""
        touched = state.touch.fingertips.contacts is not None  # at the last observation
        skin = self.skin_sensors.observed(observation, state.touch.skin, touched=touched)
        tips = self.sensors.contacts(observation, state.offsets, skin)
        memory = state.touch.memory.after(tips.fingers, tips.contacts, observation.stamp)
        monitor = state.monitor
        if tips.contacts is not None:
            monitor = replace(monitor, measured_at=observation.stamp)
        return replace(state, touch=Touch(memory, tips, skin), monitor=monitor)

    def _predicted(self, state: TrackState, observation: Observation) -> TrackState:
        """Returns the state with its belief at the observation's stamp, after changes of the grasp and slips."""
        tips = state.touch.fingertips
        memory = state.touch.memory
        belief, change = state.belief.predicted(
            observation.stamp, state.stamp, tips.fingers, observation.T_world_palm
        )
        before = state.belief.grasp
        state = replace(state, stamp=observation.stamp, belief=belief)
        if change == "grasped":
            memory = memory.only(tips.fingers)
        if belief.smoother is not None:
            if change is not None:
                state = self._regrasped(state, change, before.lasted)
            T = state.belief.known.now.T_palm_object
            slip = state.slip.copied()
            motion = slip.update(state.stamp, tips, T, belief.T_world_palm)
            if motion is not None:
                state = replace(state, belief=state.belief.slipped(motion))
            state = replace(state, slip=slip)
        if state.slip.now.slipping:
            memory = memory.only(tips.fingers)
        return replace(state, touch=replace(state.touch, memory=memory))

    def _regrasped(self, state: TrackState, change: GraspChange, lasted: float) -> TrackState:
        """Returns the state after fingers came or went; `lasted`: how long they have held the object [s]."""
        if change != "released":
            return replace(state, belief=state.belief.regrasped(state.stamp, change, self.supports, None))
        last = state.correction
        belief = state.belief
        touch = last.estimate if last is not None and lasted >= LEAST_HOLD else None
        if last is not None and touch is not None and belief.table is not None:
            # The table may be misplaced, and the next grasp would count it a second time: contacts alone stay.
            start = touch.T_palm_object_maximum
            touch = refine_pose(self.model, last.contacts, belief.known.without_touch, start)
        return replace(
            state,
            belief=belief.regrasped(state.stamp, change, self.supports, touch),
            # Once a grasp: where readings are missing, fingers come and go, and the same errors would count each time.
            offsets=self.joint_offsets(state),
            learnt_from=last,
            correction=None,
            search=None,
            monitor=replace(state.monitor, failure=None),
        )

    def _weighed(self, state: TrackState, observation: Observation) -> TrackState:
        """Returns the state after the loads of an observation."""
        tips, skin = state.touch.fingertips, state.touch.skin
        slip = state.slip.now
        grasp = state.belief.grasp
        if skin.touches:
            observation = replace(observation, wrenches={**skin.wrenches, **observation.wrenches})
        weight = state.weight.copied()
        if slip.slipping:
            weight.weigher.forget("the object slips")
        weight.update(
            observation,
            (tips.fingers, tips.contacts),
            (state.offsets.mean, state.offsets.root),
            grasped=grasp.grasped,
            lifted=grasp.lifted,
            pivots=slip.pivots,
            finger_on_table="on the table" in tips.reasons.values(),
            borne=skin.bears,
        )
        return replace(state, weight=weight)

    def _seen(self, state: TrackState, observation: Observation) -> TrackState:
        """Returns the state after the observation's image, or its pose from vision if it has no image."""
        before = state.belief
        known = state.estimate if before.grasp.grasped else None
        images = state.images.copied()
        T_palm_object = None if known is None else known.T_palm_object
        processed, hand = images.observe(observation, before.vision.camera_from_palm, T_palm_object)
        belief = before if hand is None else before.with_hand(hand)
        if processed.vision is not None:
            belief = self._with_vision(belief, images, observation, processed)
        state = replace(state, belief=belief, images=images, processed=processed)
        smoother = belief.smoother
        if smoother is not before.smoother:
            seen = replace(belief, seen_at=state.stamp)
            state = replace(state, belief=seen, monitor=replace(state.monitor, measured_at=state.stamp))
        if smoother is not None and not smoother.is_near:
            state = replace(state, belief=belief.lost(), correction=None, estimate=None, search=None)
        return state

    def _with_vision(
        self, belief: Belief, images: ImageVision, observation: Observation, processed: Observation
    ) -> Belief:
        """Returns the belief after a pose from vision, `processed.vision`, which may be that of an earlier image.

        Since the image was taken, an object in the hand has moved with the palm, another one stayed in the world.
        """
        vision = processed.vision
        assert vision is not None
        of_image = vision is not observation.vision
        grasp = belief.grasp
        latency = self.camera.latency if belief.smoother is None else belief.smoother.latency
        stamp = observation.stamp if vision.stamp is None else vision.stamp
        past = images.history.palm_at(stamp, latency)
        T_then_now = EYE
        if self.settings.concurrent_images and of_image:  # maybe seconds late
            if stamp < grasp.since or (grasp.grasped and past is None):
                return belief
            if not grasp.grasped and past is not None and belief.T_world_palm is not None:
                T_then_now = se3.inverse(past[0]) @ belief.T_world_palm
        T_world_palm, motion = belief.T_world_palm, STILL
        if grasp.grasped and past is not None:
            T_world_palm, motion = past
        if of_image:  # whose covariance includes what it shares with those before
            motion = motion._replace(drift_gain=0.0)
        return belief.with_vision(processed, T_world_palm, motion, T_then_now)

    def _corrected(self, state: TrackState, elapsed: float) -> TrackState:
        """Returns the state after a part of a correction, one that goes on or a new one if it is due."""
        search = state.search
        if search is None:
            if state.touch.fingertips.contacts is None or not self._due(state):
                return state
            search = Search(state)
            state = replace(state, weight=state.weight.copied())
            state.weight.used()
        started = search.started
        try:
            found = self._correct(started, search.answers, solves_in(elapsed))
        except Unfinished as pause:
            return replace(state, search=replace(search, answers=pause.answers))
        except (InvalidInput, np.linalg.LinAlgError) as error:
            if state.search is None and isinstance(error, InvalidInput):
                raise  # it is this observation's
            failure = _failure(started, error)
            return replace(state, search=None, monitor=replace(state.monitor, failure=failure))
        return _concluded(state, found)

    def _due(self, state: TrackState) -> bool:
        """Returns whether a correction is due: after news of vision, touch, weight or a slip, or by the set rate."""
        last, failure = state.correction, state.monitor.failure
        now = state.stamp
        if failure is not None:
            return seconds(now, failure.stamp) >= RETRY_PERIOD
        if last is None:
            return True
        age = seconds(now, last.stamp)
        touch = state.touch
        regrasped = touch.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (RETRY_PERIOD if regrasped else RECOVERY_PERIOD)
        rate = self.settings.rate
        return (
            (last.disputed_at is not None and seconds(now, last.disputed_at) >= CONFIRM_AFTER)
            or (bool(last.estimate.outliers) and age >= RECOVERY_PERIOD)
            or regrasped
            or state.belief.seen_at > last.stamp
            or state.weight.news
            or touch.skin.news(last.skin)
            or state.slip.news(last.stamp)
            or (rate is not None and age >= 1 / rate - 1e-6)
            or have_moved(touch.fingertips.records, last.records, MOVED, math.cos(TURNED))
            or _has_slid(state.belief, last)
        )

    def _correct(self, state: TrackState, answers: tuple[PoseEstimate | None, ...], most: int) -> Found:
        """Returns what a correction finds by all contacts, present or remembered, and all else that a state knows.

        See `Solver` for `answers` and `most`; raises Unfinished.
        """
        touch, belief = state.touch, state.belief
        tips, now = touch.fingertips, state.stamp
        assert tips.contacts is not None
        contacts, remembered = touch.memory.added(tips.fingers, tips.contacts, now)
        joints = None if state.processed is None else state.processed.joint_positions
        links = self.hand.at(joints and state.offsets.corrected(joints))
        pressed = touch.skin.evidence()
        prior = belief.prior
        given = prior, links, state.weight.evidence(), pressed
        solver = Solver(*problem_of(self.model, contacts, *given), answers, most)

        estimate, others = self._nearest(state, prior, solver, pressed=pressed is not None)
        searched_at = state.correction.searched_at if others is not None and state.correction else now
        if links is not None:
            # Links of the hand may be smaller than their shapes, and the contacts may belong to another pose.
            estimate = self.hand.reconciled(estimate, links, lambda weaker: solver.correct(prior, weaker))
        table = belief.table
        if table is not None and table.due(now, estimate, news=state.weight.news):
            drift = self._drift(table, now)
            table, estimate, prior = table.compared(belief.known, (estimate, prior), solver, drift, now)
        rivals = state.images.rivals
        estimate, prior, turned = among_rivals(self.model, solver, rivals, estimate, prior)
        if kept := held(self.model, state, estimate):
            return Found(kept, state.monitor.innovations, belief.table)
        belief = replace(belief, table=table)
        remedy = None
        if not estimate.consistent:
            estimate, prior, remedy = _remedied(state, belief, solver, estimate, prior)
        if remedy is not None:
            belief = remedy(belief)
        numbers = [i - len(tips.contacts) for i in estimate.outliers]
        wrong = tuple(remembered[i] for i in numbers if 0 <= i < len(remembered))
        if others:
            estimate = with_others(self.model, estimate, others)
        found, innovations = self._answer(replace(state, belief=belief), estimate, prior, searched_at)
        if turned:
            known = found.estimate
            found = replace(found, estimate=with_others(self.model, known, [*known.modes[1:], *turned]))
        return Found(found, innovations, table, remedy, wrong)

    def _answer(
        self, state: TrackState, estimate: PoseEstimate, prior: PosePrior, searched_at: float
    ) -> tuple[Correction, Innovations]:
        """Returns the correction that led to an estimate under a prior, and how well evidence has fitted."""
        tips = state.touch.fingertips
        assert tips.contacts is not None
        estimate, modes, innovations = accepted(self.model, state, estimate, prior)
        _, variance = point_uncertainty(estimate, self.model, self.model.center_object)
        correction = Correction(
            estimate=estimate,
            contacts=tips.contacts,
            by_error=tips.by_error,
            records=tips.records,
            prior=prior,
            fingers=tips.fingers,
            stamp=state.stamp,
            variance=variance,
            T_world_palm=state.belief.T_world_palm,
            skin=state.touch.skin,
            modes=modes,
            searched_at=searched_at,
        )
        return correction, innovations

    def _nearest(
        self, state: TrackState, prior: PosePrior, solver: Solver, *, pressed: bool
    ) -> tuple[PoseEstimate, Sequence[np.void] | None]:
        """Returns the estimate under a prior, and the other modes of the last search; None where it is a new search.

        The last answer is a good start while the same fingers touch, unless vision may lead to another minimum. With a
        pressed array a search takes long, and vision adds little, so the start is then the last answer.
        """
        last = state.correction
        if last is not None and state.touch.fingertips.fingers == last.fingers:
            near = last.estimate
            ambiguous = len(last.modes) > 1 and last.modes[1]["weight"] > RELEVANT_WEIGHT
            old = seconds(state.stamp, last.searched_at) >= (RECOVERY_PERIOD if ambiguous else SEARCH_PERIOD)
            doubted = old or last.disputed_at is not None or not near.consistent or bool(near.outliers)
            if not doubted and (pressed or state.belief.seen_at <= last.stamp):
                estimate = solver.refine(prior, near.T_palm_object_maximum)
                if estimate is not None:
                    return estimate, last.modes[1:]
        return solver.correct(prior), None

    def _propagated(self, state: TrackState) -> PoseEstimate:
        """Returns the object's pose now: that of the last correction, or vision's alone."""
        last = state.correction
        if last is not None:
            return last.estimate.inflated(state.belief.walked(state.stamp, last.stamp))
        now = state.belief.known.now
        # Without touch every direction is unobservable.
        seen = PoseEstimate.from_gaussian(now.T_palm_object, now.covariance[:6, :6], np.eye(6))
        return with_rivals(self.model, seen, state.images.rivals)


def _has_slid(belief: Belief, last: Correction) -> bool:
    """Returns whether an object that stands on the table has moved in the palm since a correction."""
    if last.T_world_palm is None or belief.T_world_palm is None or not belief.stands:
        return False
    T_new_old = se3.inverse(belief.T_world_palm) @ slid(last.T_world_palm, belief.T_world_palm)
    off = se3.difference(T_new_old @ last.T_world_palm, EYE)
    return bool(np.linalg.norm(off[:3]) > MOVED or np.linalg.norm(off[3:]) > TURNED)


def _remedied(
    state: TrackState, belief: Belief, solver: Solver, estimate: PoseEstimate, prior: PosePrior
) -> tuple[PoseEstimate, PosePrior, Remedy | None]:
    """Returns an estimate that contacts fit, its prior, and what is done to the belief for it; the given ones and None
    where nothing helps."""
    more = (INFLATION - 1) * prior.covariance.diagonal()
    remedies: list[Remedy] = [lambda known: known.widened(more)]
    # Until the object was lost, contacts may have been with something else, such as the edge of the table.
    if state.monitor.lost_at(state.stamp):
        remedies.append(Belief.afresh)
    for remedy in remedies:
        wider = remedy(belief).prior
        other = solver.correct(wider)
        if other.consistent:
            return other, wider, remedy
    return estimate, prior, None


def _concluded(state: TrackState, found: Found) -> TrackState:
    """Returns the state after a correction that may have begun at an earlier one has ended."""
    belief, memory = state.belief, state.touch.memory
    if belief.table is not None and found.table is not None:
        belief = replace(belief, table=belief.table.compared_as(found.table))
    if found.remedy is not None:
        belief = found.remedy(belief)
    if found.wrong:
        memory = memory.only(memory.last.keys() - found.wrong)
    monitor = replace(
        state.monitor,
        innovations=found.innovations,
        corrections=state.monitor.corrections + 1,
        failure=None,
    )
    touch = replace(state.touch, memory=memory)
    return replace(
        state, belief=belief, touch=touch, monitor=monitor, search=None, correction=found.correction
    )


def _failure(started: TrackState, error: Exception) -> Failure:
    """Returns the failure of a correction that began at a state; its reason names the evidence."""
    evidence = [f"finger {name}" for name in started.touch.fingertips.fingers]
    evidence += ["skin"] * started.touch.skin.pressed + ["vision"]
    evidence += ["the table"] * (started.belief.table is not None)
    by = f"the correction by {', '.join(evidence)} at {started.stamp:.3f} s failed"
    return Failure(started.stamp, f"{by}: {str(error) or type(error).__name__}")
