"""One object followed in one hand: its pose is propagated in time, and corrected when there is new evidence."""

# mypy: disable-error-code="misc"
# A step assigns the fields of its own copy of a state, `_Next`; a `TrackState` is frozen for everybody else.

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from handsight import se3
from handsight._kernels.touch.contacts_to_palm import have_moved
from handsight.checks import Array
from handsight.correction import Outside, PoseEstimate, PosePrior, refine_pose
from handsight.correction.correct import corrected, problem_of, refined
from handsight.correction.estimate import point_uncertainty
from handsight.correction.outside import outside_records
from handsight.correction.problem import Steps
from handsight.forces import WeightSensor
from handsight.objects import ObjectModel
from handsight.objects.resting import resting_poses
from handsight.observation import Observation
from handsight.rig import MountedCamera, Rig
from handsight.tracking.concurrent_images import ConcurrentImages
from handsight.tracking.continuity import CONFIRM_AFTER, disputed
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.grasp import ContactMemory, GraspChange, GraspState, slid
from handsight.tracking.hand_outside import LINK_CHECK_PERIOD, HandOutside
from handsight.tracking.hypotheses import RELEVANT_WEIGHT, ambiguity, with_others
from handsight.tracking.images import ImageVision, ObjectInImages
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import EYE, VisionUpdate
from handsight.tracking.misfit import NO_INNOVATIONS
from handsight.tracking.runner import CORRECTED, Runner, steps_in
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinSensors
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import STILL, PoseBiasSmoother, process_variance
from handsight.tracking.table import TableEstimate, TableEvidence, supports_of
from handsight.tracking.track_state import NO_POSE, Correction, Progress, State, TrackState
from handsight.vision import FirstPoseSource, locate

INFLATION = 9
"""Factor on the prior's variance when contacts fit no pose near it: the search then starts from several poses."""
RECOVERY_PERIOD = 0.5
"""Time between two such searches, and between corrections while nothing fits: each costs as much as a hundred
others [s]."""
SEARCH_PERIOD = 3  # between two searches for other modes, where vision brings none about [s]
RETRY_PERIOD = 0.1  # time between corrections while nothing fits, if other fingers touch now [s]
LOST_WITHOUT_FIT = 2.0  # how long contacts may contradict every pose before the object is lost [s]
MIN_CONTACTS_TO_LEARN = 3
"""The joints' offsets are learnt from so many contacts or more: fewer determine the pose alone."""
RENEW_AFTER = 0.02
"""A propagated covariance is renewed when it is older [s]: in that time it grows by a micrometre or so."""


MOVED = 0.001
TURNED = float(np.deg2rad(5))
"""The pose is corrected when a contact has moved by so much in the palm [m], or its normal by so much [rad]."""
REGRASP_POSITION = 0.005
REGRASP_ROTATION = float(np.deg2rad(3))
"""How far the object may be pushed [m] and turned [rad] when a finger comes or goes, one sigma per axis."""


class _Next(TrackState):
    """A `_Next` is the copy of a state that a step changes, field by field, into the next state."""

    def __init__(self, state: TrackState) -> None:
        # All fields at once: to set one after the other, as a frozen dataclass does, takes three times as long.
        self.__dict__ = vars(state).copy()
        self.images, self.slip = state.images.copied(), state.slip.copied()
        self.weight = state.weight.copied()

    __setattr__ = object.__setattr__

    def frozen(self) -> TrackState:
        """Returns the next state, as a value; this object must not be changed any more."""
        state = object.__new__(TrackState)
        object.__setattr__(state, "__dict__", self.__dict__)
        return state


class Follower:
    """Makes the next state of a track; it holds the robot, the object and the settings, but no state."""

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        settings: TrackerSettings,
        source: FirstPoseSource = locate,
    ) -> None:
        """The arguments are those of `Tracker`."""
        self.source = source
        self.rig = rig
        self.model = model
        self.settings = settings
        s = settings
        self.camera = rig.camera or MountedCamera()
        self.sensors = FingertipSensors(rig)
        self.skin_sensors = SkinSensors(rig)
        self.hand = HandOutside(rig, model, s.outside)
        self.process_noise = np.repeat([s.process_noise_position**2, s.process_noise_rotation**2], 3)
        """(6,) variance of the object's random walk in the palm, per second [m², rad²]."""
        self.regrasp_noise = np.repeat([REGRASP_POSITION**2, REGRASP_ROTATION**2], 3)
        """(6,) variance of the object's motion when a finger comes or goes [m², rad²]."""
        poses = () if rig.table is None else resting_poses(model, model.center_of_mass)
        self._runner = Runner(self._correct)
        self.supports = supports_of(poses)
        """What may bear the object while it is on the table."""

    def initial(self, start: PosePrior | None, offsets: JointOffsets) -> TrackState:
        """Returns the state before any observation; `start`: the object's pose in the palm, None where unknown."""
        vision = VisionUpdate(self.rig, self.model)
        follow = ConcurrentImages if self.settings.concurrent_images else ObjectInImages
        return TrackState(
            start=start,
            smoother=_started(vision, start),
            grasp=GraspState(),
            memory=ContactMemory(self.settings.memory, self.process_noise),
            vision=vision,
            images=ImageVision(self.rig, self.model, self.source, on=self.settings.images, follow=follow),
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
        new = _Next(state)
        estimate = self._follow(new, observation)
        return new.frozen(), estimate

    def sigma(self, state: TrackState) -> float:
        """Returns the largest standard deviation of the position of the object's middle [m]; infinite before a pose."""
        last = state.correction
        if last is not None:
            return math.sqrt(last.variance + self._motion_since(last, state)[0])
        if state.estimate is None:
            return math.inf
        return math.sqrt(point_uncertainty(state.estimate, self.model, self.model.center_object)[1])

    def table(self, state: TrackState) -> TableEstimate | None:
        """Returns where the table must be, given the object's pose; None before the object was grasped on it."""
        if state.table is None or state.estimate is None:
            return None
        drift = process_variance(self.process_noise, state.stamp - state.table.stamp)
        return state.table.estimated(state.estimate, drift)

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

    def _follow(self, state: _Next, observation: Observation) -> PoseEstimate | None:
        """Updates the state by an observation, and returns the pose; None before there is one."""
        joints, stamp = observation.joint_positions, observation.stamp
        elapsed = stamp - state.stamp
        if self.rig.world_from == "joints" and observation.T_world_palm is None and joints is not None:
            T = self.rig.hand.T_world_palm(joints)
            T = se3.check(T, "observation.joint_positions: palm in the world")
            observation = replace(observation, T_world_palm=T)

        # Contacts, and the prediction: where the object would be by now.
        touched = state.fingertips.contacts is not None  # at the last observation
        state.skin = skin = self.skin_sensors.observed(observation, state.skin, touched=touched)
        state.fingertips = touch = self.sensors.contacts(observation, state.offsets, skin)
        self._predict(state, observation.T_world_palm, stamp)
        loaded = observation
        if skin.touches:
            loaded = replace(observation, wrenches={**skin.wrenches, **observation.wrenches})
        state.weight.update(
            loaded,
            (touch.fingers, touch.contacts),
            (state.offsets.mean, state.offsets.root),
            grasped=state.grasp.grasped,
            lifted=state.grasp.lifted,
            pivots=state.slip.now.pivots,
            finger_on_table="on the table" in touch.reasons.values(),
            borne=skin.bears,
        )

        # Vision.
        before = state.smoother
        self._measure_by_vision(state, observation)
        if vision := state.smoother is not before:
            state.observed_at = stamp
        if state.smoother is not None and not state.smoother.is_near:
            # The palm has moved so far away that the hand cannot hold the object.
            state.smoother = _started(state.vision, state.start)
            state.correction = None
            state.estimate = None
            state.progress = None
        if vision or touch.contacts is not None:
            state.measured_at = stamp
        if state.smoother is None:
            state.label = "lost"
            state.reason = NO_POSE
            return None

        # The answer: corrected, or propagated from the last correction, or vision's alone.
        if state.progress is None and touch.contacts is not None and self._due(state):
            state.progress = Progress(_Next(state).frozen())
            state.weight.used()
        if state.progress is not None:
            self._continued(state, state.progress, elapsed)
        last = state.correction
        if state.estimate is None or last is None:  # without touch every direction is unobservable
            now = state.smoother.now
            state.estimate = PoseEstimate.from_gaussian(now.T_palm_object, now.covariance[:6, :6], np.eye(6))
        elif stamp - state.propagated_to > RENEW_AFTER:
            state.estimate = last.estimate.inflated(self._motion_since(last, state))
            state.propagated_to = stamp
        if state.estimate.consistent or state.fits_at == -math.inf:
            state.fits_at = stamp
        state.label, state.reason = self._trust(state, state.estimate)
        return state.estimate

    def _predict(self, state: _Next, T_world_palm: Array | None, stamp: float) -> None:
        """Propagates the smoother to `stamp`, and through changes of the grasp."""
        before = state.grasp
        fingers = state.fingertips.fingers
        palm = state.T_world_palm if T_world_palm is None else T_world_palm
        state.grasp, change = before.after(fingers, stamp, palm)
        if T_world_palm is not None and state.T_world_palm is not None:
            self._carry(state, before, state.T_world_palm, T_world_palm)
        if state.smoother is not None and stamp > state.stamp > -math.inf:
            seconds = stamp - state.stamp
            state.smoother = state.smoother.inflated(self.process_noise * seconds, seconds)
        state.T_world_palm = palm
        state.stamp = stamp
        state.memory = state.memory.after(fingers, state.fingertips.contacts, stamp)
        if change == "grasped":
            state.memory = state.memory.only(fingers)
        if (smoother := state.smoother) is not None:
            smoother = smoother if change is None else self._regrasped(state, smoother, change)
            state.smoother = state.slip.update(stamp, state.fingertips, smoother, palm)
            if state.table is not None and state.smoother is not smoother:
                slipped = state.smoother.prior.covariance - smoother.now.covariance
                state.table = state.table.restarted(smoother, slipped[:6, :6])
        if state.slip.now.slipping:
            state.memory = state.memory.only(fingers)
            state.weight.weigher.forget("the object slips")

    def _carry(self, state: _Next, before: GraspState, T_before: Array, T_now: Array) -> None:
        """Moves the object's pose in the palm as the palm moves in the world, where the object does not move with it:
        one that is not grasped stays where it is, and one that stands on the table keeps its height and its tilt."""
        if np.array_equal(T_before, T_now) or (before.grasped and not self._stands(state, before)):
            return
        motion = slid(T_before, T_now) if before.grasped else EYE
        T_new_old = se3.inverse(T_now) @ motion @ T_before
        if state.smoother is not None:
            state.smoother = state.smoother.transformed(T_new_old)
        if state.table is not None:
            state.table = state.table.transformed(T_new_old, T_now)

    def _stands(self, state: TrackState, before: GraspState) -> bool:
        """Returns whether a grasped object still stands on the table."""
        return self.rig.table is not None and not (before.carried or state.grasp.carried)

    def _regrasped(self, state: _Next, smoother: PoseBiasSmoother, change: GraspChange) -> PoseBiasSmoother:
        """Returns the smoother after fingers came or went, which may have pushed the object."""
        last = state.correction
        pose = smoother.now
        T = state.T_world_palm
        table = self.rig.table
        if change == "released":
            # Once a grasp: where readings are missing, fingers come and go, and the same errors would count each time.
            state.offsets = self.joint_offsets(state)
            state.learnt_from = last
            touch = None if last is None else last.estimate
            if last is not None and touch is not None and state.table is not None:
                # The table may be misplaced, and the next grasp would count it a second time: contacts alone stay.
                prior, start = smoother.without_touch, touch.T_palm_object_maximum
                touch = refine_pose(self.model, last.contacts, prior, start)
            if touch is not None:
                # What was measured of the pose up to now stays true; the object's motion from now on is unknown.
                pose = pose.given_pose(touch.T_palm_object, touch.information)
            state.correction = state.table = state.progress = state.failure = None
        pose = pose.inflated(self.regrasp_noise)
        if change != "released" and table is not None and T is not None and not state.grasp.lifted:
            state.table = TableEvidence.of(self.model, table, self.supports, pose, T, state.stamp)
        elif state.table is not None:
            state.table = state.table.restarted(smoother, np.diag(self.regrasp_noise))
        return smoother.restarted(pose)

    def _measure_by_vision(self, state: _Next, observation: Observation) -> None:
        """Updates the smoother by the observation's image, or by its pose from vision if it has no image."""
        known = state.estimate
        grasped = state.grasp.grasped
        T_palm_object = known.T_palm_object if known is not None and grasped else None
        processed, hand = state.images.observe(observation, state.vision.camera_from_palm, T_palm_object)
        state.processed, before = processed, state.smoother
        if hand is not None:
            state.vision, state.smoother = state.vision.palm_detected(hand, before)
            if state.table is not None and before is not None and state.smoother is not before:
                state.table = state.table.informed(before, hand.bias(before.pivot))
        if (vision := processed.vision) is None:
            return
        # Since the image was taken, an object in the hand has moved with the palm, another one stayed in the world.
        latency = self.camera.latency if state.smoother is None else state.smoother.latency
        stamp = observation.stamp if vision.stamp is None else vision.stamp
        past = state.images.history.palm_at(stamp, latency)
        T_then_now = EYE
        if self.settings.concurrent_images and vision is not observation.vision:  # maybe seconds late
            if stamp < state.grasp.since or (grasped and past is None):
                return
            if not grasped and past is not None and state.T_world_palm is not None:
                T_then_now = se3.inverse(past[0]) @ state.T_world_palm
        past = past if grasped else None
        T_world_palm, motion = past or (state.T_world_palm, STILL)
        if vision is not observation.vision:
            # An image's covariance includes what it shares with those before.
            motion = motion._replace(drift_gain=0.0)
        state.vision, after = state.vision.updated(
            processed, state.smoother, T_world_palm, motion, T_then_now
        )
        state.smoother = after
        if before is not None and after is not None and (after.process_noise < before.process_noise).any():
            state.table = None  # vision has started anew, as the object was moved

    def _due(self, state: _Next) -> bool:
        """Returns whether a correction is due: after news of vision, touch, weight or a slip, or by the set rate."""
        last, failure = state.correction, state.failure
        if failure is not None and state.stamp - failure.stamp < RETRY_PERIOD:
            return False
        if last is None or failure is not None:
            return True
        age = state.stamp - last.stamp
        regrasped = state.fingertips.fingers != last.fingers
        if not last.estimate.consistent:
            return age >= (RETRY_PERIOD if regrasped else RECOVERY_PERIOD)
        if last.disputed_at is not None and state.stamp - last.disputed_at >= CONFIRM_AFTER:
            return True
        news = state.weight.news or state.skin.news(last.skin) or state.slip.news(last.stamp)
        if state.observed_at > last.stamp or regrasped or news:
            return True
        if self.settings.rate is not None and age >= 1 / self.settings.rate - 1e-9:
            return True
        if have_moved(state.fingertips.records, last.records, MOVED, math.cos(TURNED)):
            return True
        if last.T_world_palm is None or state.T_world_palm is None or not self._stands(state, state.grasp):
            return False
        T_new_old = se3.inverse(state.T_world_palm) @ slid(last.T_world_palm, state.T_world_palm)
        off = se3.difference(T_new_old @ last.T_world_palm, EYE)
        return bool(np.linalg.norm(off[:3]) > MOVED or np.linalg.norm(off[3:]) > TURNED)

    def _motion_since(self, last: Correction, state: TrackState) -> Array:
        """Returns the variance (6,) of the object's motion since a correction [m², rad²]."""
        noise = process_variance(self.process_noise, state.stamp - last.stamp)
        return noise + self.regrasp_noise if state.grasp.changed > last.stamp else noise

    def _continued(self, state: _Next, progress: Progress, elapsed: float) -> None:
        """Continues a correction; once it has ended, what it has found replaces what the state had before."""
        state.progress, found = self._runner.run(progress, steps_in(elapsed))
        if found is None:
            return
        started = progress.started
        seconds = state.stamp - progress.started.stamp
        for name in CORRECTED:
            setattr(state, name, getattr(found, name))
        if found.smoother is not started.smoother and found.smoother is not None:  # by another prior
            noise = process_variance(self.process_noise, seconds)
            state.smoother = found.smoother.inflated(noise, seconds)
        if state.table is started.table:
            state.table = found.table
        if found.memory is not started.memory:
            wrong = started.memory.last.keys() - found.memory.last.keys()
            state.memory = state.memory.only(state.memory.last.keys() - wrong)

    def _correct(self, started: TrackState) -> Steps[TrackState]:
        """Returns the state after its pose was corrected, in steps: by all contacts, present or remembered, with the
        smoother's pose as prior."""
        state = _Next(started)
        state.failure = None
        touch = state.fingertips
        now = state.stamp
        last = state.correction
        skin = state.skin
        touched, smoother, observed = touch.contacts, state.smoother, state.processed
        assert touched is not None and smoother is not None  # noqa: PT018
        smoother = smoother if state.table is None else state.table.smoother(smoother)
        contacts, remembered = state.memory.added(touch.fingers, touched, now)
        joints = None if observed is None else observed.joint_positions
        links = self.hand.at(joints and state.offsets.corrected(joints))
        pressed = skin.evidence()
        evidence = state.weight.evidence()
        prior = smoother.without_touch
        problem, patches = problem_of(self.model, contacts, prior, links, evidence, pressed)

        def correct(prior: PosePrior, weaker: Outside | None = None) -> Steps[PoseEstimate]:
            given = replace(problem, vision=prior)
            if weaker is not None:
                given = replace(given, outside=outside_records(self.model, given.contacts, weaker, pressed))
            return corrected(given, patches)

        def refine(prior: PosePrior, T_start: Array) -> Steps[PoseEstimate | None]:
            return refined(replace(problem, vision=prior), patches, T_start)

        # The last answer is a good start while the same fingers touch, unless vision may lead to another minimum. With
        # a pressed array a search takes long, and vision adds little, so the start is then the last answer.
        estimate = None
        searched_at = now
        others: Sequence[np.void] = ()
        same = last is not None and touch.fingers == last.fingers
        if last is not None and same and (state.observed_at <= last.stamp or pressed is not None):
            near = last.estimate
            age = now - last.searched_at
            ambiguous = len(last.modes) > 1 and last.modes[1]["weight"] > RELEVANT_WEIGHT
            search = age >= (RECOVERY_PERIOD if ambiguous else SEARCH_PERIOD)
            search = search or last.disputed_at is not None
            if near.consistent and not near.outliers and not search:
                estimate = yield from refine(prior, near.T_palm_object_maximum)
                others = last.modes[1:]
                searched_at = last.searched_at
        if estimate is None:
            estimate = yield from correct(prior)
            others = ()
            searched_at = now

        # Links of the hand may be smaller than their shapes, and the contacts may belong to another pose.
        fits = estimate.consistent and not estimate.outliers
        if links is not None and not (fits and now - state.links_checked_at < LINK_CHECK_PERIOD):
            state.links_checked_at = now
            estimate = yield from self.hand.reconciled(estimate, links, lambda weaker: correct(prior, weaker))
        table, known = state.table, state.smoother
        if table is not None and known is not None and table.due(now, estimate, news=state.weight.news):
            drift = process_variance(self.process_noise, now - table.stamp)
            state.table, estimate, prior = yield from table.compared(
                known, (estimate, prior), correct, refine, drift, now
            )
        if last is not None and touch.fingers == last.fingers and not state.slip.now.slipping:
            creep = process_variance(self.process_noise, now - last.stamp)
            if kept := disputed(self.model, last, estimate, creep, now):
                state.correction = kept
                state.estimate = kept.estimate
                state.propagated_to = now
                state.corrections = state.corrections + 1
                state.table = table
                return state
        if not estimate.consistent and now - state.recovered_at >= RECOVERY_PERIOD:
            state.recovered_at = now
            estimate, prior = yield from self._recovered(state, estimate, prior, correct)

        state.weight.used()
        wrong = [
            remembered[i - len(touched)] for i in estimate.outliers if 0 <= i - len(touched) < len(remembered)
        ]
        if wrong:
            state.memory = state.memory.only(state.memory.last.keys() - wrong)
        if others:  # those that were found by the last search
            estimate = with_others(self.model, estimate, others)
        yield
        estimate, modes = self._judged(state, estimate, prior)
        _, variance = point_uncertainty(estimate, self.model, self.model.center_object)
        state.correction = Correction(
            estimate=estimate,
            contacts=touched,
            by_error=touch.by_error,
            records=touch.records,
            prior=prior,
            fingers=touch.fingers,
            stamp=now,
            variance=variance,
            T_world_palm=state.T_world_palm,
            skin=skin,
            modes=modes,
            searched_at=searched_at,
        )
        state.estimate, state.propagated_to = estimate, now
        state.corrections += 1
        return state

    def _judged(
        self, state: _Next, estimate: PoseEstimate, prior: PosePrior
    ) -> tuple[PoseEstimate, Sequence[np.void]]:
        """Returns a correction's estimate with the other explanations of the table, and with a covariance inflated by
        what has not fitted the model lately; and its modes under its `prior` alone."""
        last, now = state.correction, state.stamp
        age = 0.0 if last is None else now - last.stamp
        afresh = estimate.consistent and now - state.fits_at > LOST_WITHOUT_FIT  # found again
        watched = NO_INNOVATIONS if last is None or afresh else state.innovations
        watched = watched.after(age, state.fingertips.fingers, estimate, prior)
        estimate = watched.covered(self.model, estimate, prior)
        modes = tuple(estimate.modes)
        if state.table is not None and state.table.alternatives is not None:
            estimate = state.table.alternatives.added(self.model, estimate)
        # An answer that contacts did not fit was called wrong before it moved.
        if last is not None and last.estimate.consistent and not state.slip.now.slipping:
            noise = self._motion_since(last, state)
            watched = watched.moved(age, self.model, last.estimate, estimate, noise)
        state.innovations = watched
        return watched.inflated(estimate), modes

    def _recovered(
        self,
        state: _Next,
        estimate: PoseEstimate,
        prior: PosePrior,
        correct: Callable[[PosePrior], Steps[PoseEstimate]],
    ) -> Steps[tuple[PoseEstimate, PosePrior]]:
        """Returns an estimate that contacts fit, and its prior; both unchanged where none fits.

        The priors that are tried: a wider one, and, where nothing has fitted for long, vision's last pose alone. The
        smoother and the table of the one that fits replace the state's.
        """
        known = state.smoother
        more = (INFLATION - 1) * prior.covariance.diagonal()
        if known is None:
            return estimate, prior
        table = None if state.table is None else state.table.restarted(known, np.diag(more))
        tries = [(known.restarted(known.now.inflated(more)), table)]
        # Until the object was lost, contacts may have been with something else, such as the edge of the table.
        if state.stamp - state.fits_at > LOST_WITHOUT_FIT and (afresh := state.vision.afresh()):
            tries.append((afresh, None))
        for smoother, table in tries:
            wider = (smoother if table is None else table.smoother(smoother)).without_touch
            if (found := (yield from correct(wider))).consistent:
                state.smoother, state.table = smoother, table
                return found, wider
        return estimate, prior

    def _trust(self, state: _Next, estimate: PoseEstimate) -> tuple[State, str]:
        """Returns how far the estimate can be trusted, and why not further."""
        other = state.innovations.touch
        if state.measured_at == -math.inf:
            return "lost", "nothing was touched or seen yet"
        if (since := state.stamp - state.measured_at) > self.settings.lost_after:
            return "lost", f"nothing touched and nothing seen for {since:.1f} s"
        if (since := state.stamp - state.fits_at) > LOST_WITHOUT_FIT:
            reason = f"the contacts have fitted no pose for {since:.1f} s"
            return "lost", f"{reason}: {other}" if other else reason
        if state.failure is not None:
            return "uncertain", state.failure.reason
        if (slip := state.slip.now).slipping:
            reason = "the object slips: every finger that holds it is at the limit of friction"
            return "uncertain", f"{reason}; {slip.doubt}" if slip.doubt else reason
        if not estimate.consistent:
            reason = "the contacts do not fit the object at its estimated pose"
            return "uncertain", f"{reason}: {other}" if other else reason
        if unzeroed := ", ".join(state.skin.unzeroed):
            return "uncertain", f"skin {unzeroed}: pressed since its first readings: its offset is unknown"
        if doubt := state.weight.doubt:
            return "uncertain", doubt
        if ambiguous := ambiguity(self.model, estimate):
            return "uncertain", ambiguous
        if state.correction is not None and (misfit := state.innovations.worst):
            why = state.weight.elsewhere(estimate) if misfit.name == "weight" else other
            return "uncertain", f"{misfit}: {why}" if why else str(misfit)
        if state.correction is None and not state.vision.camera_from_palm.confirmed:
            return "uncertain", "nothing is touched: the pose is vision's"
        if (sigma := self.sigma(state)) > self.settings.uncertain_position:
            reason = f"the position is known to {1e3 * sigma:.0f} mm only"
            doubt = "" if state.table is None else state.table.doubt(estimate)
            return "uncertain", f"{reason}; the table: {doubt}" if doubt else reason
        return "tracking", ""


def _started(vision: VisionUpdate, start: PosePrior | None) -> PoseBiasSmoother | None:
    """Returns the smoother at the start of a track; None where the object's pose is unknown."""
    if start is None:
        return None
    return vision.smoother_from(start.T_palm_object, start.covariance, np.zeros(3))
