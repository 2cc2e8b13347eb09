"""What the viewer shows: a state of a track, less what is not drawn; and the moments of a track in order."""

import bisect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array, Mask
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.evaluation import Truths
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking import FingertipContacts, State
from handsight.tracking.judge import sigma
from handsight.tracking.skin import SkinContacts
from handsight.tracking.track_state import TrackState
from handsight.viewer.picture import Picture, picture
from handsight.viewer.shapes import middle

VISION_FOR = 1.0  # how long the last measurement of vision is shown [s]
LIKELY = 0.02  # smallest probability of another mode that is shown
NEAR_SLIPPING = 0.8  # share of what friction holds from which it is said
MOMENT_PERIOD = 1 / 30  # between two moments [s]
IMAGE_PERIOD = 0.1  # between two images [s]: each takes 40 kB
TIME_TOLERANCE = MOMENT_PERIOD / 32  # difference below which two stamps are the same [s]
MAX_PLOTTED = 300  # moments in a plot


class Measured(NamedTuple):
    """The last pose that vision measured."""

    stamp: float  # [s]
    T_palm_object: Array  # (4, 4), vision's bias included


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Moment:
    """An estimate and the evidence for it."""

    stamp: float  # [s]
    state: State
    reason: str  # why the state is no better; empty while tracking
    estimate: PoseEstimate | None  # None: nothing is known of the object yet
    sigma: float  # largest sigma of the position of the object's middle [m]; infinite without an estimate
    fingertips: FingertipContacts
    skin: SkinContacts
    slip: Slip
    T_world_palm: Array | None  # (4, 4)
    joint_positions: Mapping[str, float] | None  # by name [rad]
    vision: Measured | None  # None where vision has measured nothing for `VISION_FOR`
    picture: Picture | None  # the last image; None before the first

    @property
    def outliers(self) -> tuple[str, ...]:
        """Fingers whose contacts the estimate rejects."""
        return () if self.estimate is None else self.fingertips.rejected_by(self.estimate)

    def links(self, rig: Rig) -> dict[str, Array]:
        """Returns T_palm_link (4, 4) of the links whose pose is known, by name."""
        try:
            return rig.hand.link_poses(self.joint_positions or {})
        except InvalidInput:  # the tracker rejects these joints too, and its reason says why
            return {}

    def forces(self) -> dict[str, Array]:
        """Returns the force (3,) of the object on each finger that touches and measures it, in the palm [N]. Without
        the palm's pose in the world the weight of the tips is included."""
        touch = self.fingertips
        if touch.contacts is None or touch.loads is None:
            return {}
        forces = touch.loads[:, :3] + touch.loads[:, 3:4] * touch.contacts.normals_palm
        named = zip(touch.fingers, forces, strict=True)
        return {name: force for name, force in named if np.isfinite(force).all()}

    @property
    def why(self) -> str:
        """A sentence that says why the state is no better, and what the evidence is."""
        estimate = self.estimate
        fingers = self.fingertips.fingers
        parts = [self.reason] if self.reason else []
        if fingers:
            fit = " and fit the object" if estimate is not None and estimate.consistent else ""
            parts.append(f"{', '.join(fingers)} touch{fit}")
        elif "touched" not in self.reason:
            parts.append("no finger touches")
        if estimate is not None:
            least = self.slip.least or 0.0
            if least >= NEAR_SLIPPING and not self.slip.slipping:
                parts.append(f"the grip uses {least:.0%} of what friction holds")
            if self.outliers:
                parts.append(f"{', '.join(self.outliers)} left out as wrong")
            if math.isfinite(self.sigma) and "known to" not in self.reason:
                parts.append(f"the position is known to {1000 * self.sigma:.1f} mm")
            if fingers and len(estimate.unobservable):
                parts.append(f"touch leaves {len(estimate.unobservable)} of 6 directions open")
            if others := [mode.weight for mode in estimate.hypotheses[1:] if mode.weight >= LIKELY]:
                parts.append(f"another pose is likely by {others[0]:.0%}")
        return f"{'; '.join(parts)}."


class Curves(NamedTuple):
    """Uncertainty, error and state over time."""

    times: Array  # (n,) ascending, since the origin [s]
    sigmas: Array  # (n,) of the position [mm], NaN where nothing is known
    errors: Array  # (n,) of the object's middle [mm], NaN where the truth is not known
    states: NDArray[np.str_]  # (n,) of the track
    slipping: Mask  # (n,) whether the object slips, or does before the next of these times


class Timeline:
    """The moments of a track in order of stamp; another thread may read while one adds."""

    def __init__(self, rig: Rig, model: ObjectModel, most: int | None = None) -> None:
        """`most`: how many moments are kept, the newest; None: all."""
        self.rig = rig
        self.model = model
        self.truth: Sequence[tuple[float, Array]] = ()
        """Stamps [s] and true poses T_palm_object (4, 4), to be set where they are known; it may grow."""
        self.moments = list[Moment]()
        self.origin = 0.0
        """Stamp of the first moment, from which time is counted [s]."""
        self._most = most
        self._picture: Picture | None = None
        self._pictured = -math.inf  # when the newest image was taken [s]

    def see(self, state: TrackState) -> None:
        """Keeps the images that were processed last, if there are any, unless others are as new."""
        if not 0 <= state.stamp - self._pictured < IMAGE_PERIOD:
            seen = picture(self.rig, state)
            if seen is not None:
                self._picture = seen
                self._pictured = state.stamp

    def add(self, state: TrackState) -> None:
        """Adds a state, in place of the last one if that is less than a `MOMENT_PERIOD` after the one before.

        Begins anew where the clock was set back.
        """
        if self.moments and state.stamp < self.moments[-1].stamp:
            self.moments = []
            self._picture = None
        if not self.moments:
            self.origin = state.stamp
        self.see(state)
        moments = self.moments
        moment = self._moment(state, moments[-1] if moments else None)
        if len(moments) > 1 and moments[-1].stamp - moments[-2].stamp < MOMENT_PERIOD - TIME_TOLERANCE:
            moments[-1] = moment
        else:
            moments.append(moment)
        if self._most is not None:
            self.moments = moments[-self._most :]

    @property
    def begin(self) -> float:
        """Time of the first moment that is kept, since the origin [s]."""
        return self.moments[0].stamp - self.origin if self.moments else 0.0

    @property
    def end(self) -> float:
        """Time of the last moment, since the origin [s]."""
        return self.moments[-1].stamp - self.origin if self.moments else 0.0

    def at(self, time: float) -> Moment:
        """Returns the last moment that is not later than a time since the origin [s], or the first one."""
        # origin + (stamp - origin) may round to less than the stamp: seconds since 1970 have a resolution of 0.25 µs.
        stamp = self.origin + time + TIME_TOLERANCE
        moments = self.moments
        later = bisect.bisect_right(moments, stamp, key=lambda moment: moment.stamp)
        return moments[max(0, later - 1)]

    def curves(self) -> Curves:
        """Returns the curves of at most `MAX_PLOTTED` moments, evenly chosen, the first and the last among them."""
        moments = list(self.moments)
        chosen = np.linspace(0, len(moments) - 1, min(len(moments), MAX_PLOTTED)).astype(int)
        slipping = np.array([moment.slip.slipping for moment in moments])
        shown = [moments[k] for k in chosen]
        sigmas = np.array([moment.sigma for moment in shown])
        truths = Truths(self.truth)
        errors = np.full(len(shown), np.nan)
        for k, moment in enumerate(shown):
            T_true = truths.at(moment.stamp)
            if moment.estimate is not None and T_true is not None:
                # Symmetries leave the middle in place.
                off = middle(self.model, moment.estimate.T_palm_object) - middle(self.model, T_true)
                errors[k] = 1000 * np.linalg.norm(off)
        return Curves(
            times=np.array([moment.stamp for moment in shown]) - self.origin,
            sigmas=np.where(np.isfinite(sigmas), 1000 * sigmas, np.nan),
            errors=errors,
            states=np.array([moment.state for moment in shown]),
            slipping=np.logical_or.reduceat(slipping, chosen),
        )

    def _moment(self, state: TrackState, last: Moment | None) -> Moment:
        """Returns a state as a moment, with vision's last pose while it is fresh."""
        observation = state.processed
        belief = state.belief
        T_vision = belief.vision.in_palm(observation, belief.T_world_palm)
        vision = None if last is None else last.vision
        if T_vision is not None:
            vision = Measured(state.stamp, T_vision)
        elif vision is not None and state.stamp - vision.stamp >= VISION_FOR:
            vision = None
        return Moment(
            stamp=state.stamp,
            state=state.monitor.label,
            reason=state.monitor.reason,
            estimate=state.estimate,
            sigma=sigma(self.model, state),
            fingertips=state.touch.fingertips,
            skin=state.touch.skin,
            slip=state.slip.now,
            T_world_palm=belief.T_world_palm,
            joint_positions=None if observation is None else observation.joint_positions,
            vision=vision,
            picture=self._picture,
        )
