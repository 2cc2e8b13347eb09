"""Whether a correction counts, and how far the answer can be trusted.

A correction that fits is accepted. A single one that contradicts the last is held: one wrong reading would else reject
a finger, doubt the table or move the object, and the next one would take it all back. What has not fitted for a while
inflates the answer (`misfit.py`), and an object that no pose has fitted for long is lost.
"""

import math
from dataclasses import replace

import numpy as np

from handsight import se3
from handsight.correction import PoseEstimate, PosePrior
from handsight.correction.estimate import point_uncertainty
from handsight.objects import ObjectModel
from handsight.observation import seconds
from handsight.tracking.answer import Correction
from handsight.tracking.hypotheses import ambiguity
from handsight.tracking.misfit import NO_INNOVATIONS, Innovations
from handsight.tracking.monitor import Monitor, State
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.smoother import process_variance
from handsight.tracking.track_state import TrackState

CONFIRM_AFTER = 0.1
"""For so long corrections must dispute the last answer before one of them counts [s]."""


def held(model: ObjectModel, state: TrackState, new: PoseEstimate) -> Correction | None:
    """Returns the last correction, propagated to now, where a new one disputes it that does not count yet.

    That is while the same fingers touch an object that does not slip. A correction disputes the last one if it moves
    the object's middle, or turns it, by more than sigma, rejects a contact, or fits no pose. It counts once corrections
    have done so for `CONFIRM_AFTER`; before a larger step sigma grows by the step.
    """
    last = state.correction
    now = state.stamp
    same = last is not None and state.touch.fingertips.fingers == last.fingers
    if last is None or not same or state.slip.now.slipping or not last.estimate.consistent:
        return None
    known = last.estimate
    creep = process_variance(state.belief.process_noise, seconds(now, last.stamp))
    T, middle = known.T_palm_object, model.center_object
    T_new = model.nearest(new.T_palm_object, T)
    turn = se3.difference(T_new, T)[3:]
    shift = (T_new - T)[:3, :3] @ middle + (T_new - T)[:3, 3]
    steps = np.array([shift @ shift, turn @ turn])
    # The variance of the turn about its axis, times the turn's square.
    along = float(turn @ (known.bounded_covariance[3:, 3:] + np.diag(creep[3:])) @ turn)
    far = steps[0] > last.variance + creep[0] or steps[1] ** 2 > along
    rejects = bool(new.outliers) and not known.outliers
    if not far and not rejects and new.consistent:
        return None
    since = now if last.disputed_at is None else last.disputed_at
    variance = creep
    if seconds(now, since) >= CONFIRM_AFTER:
        if not far or not new.consistent:
            return None
        variance = creep + np.repeat(steps, 3)
    kept = known.inflated(variance)
    _, of_middle = point_uncertainty(kept, model, middle)
    return replace(last, estimate=kept, stamp=now, variance=of_middle, disputed_at=since)


def accepted(
    model: ObjectModel, state: TrackState, estimate: PoseEstimate, prior: PosePrior
) -> tuple[PoseEstimate, tuple[np.void, ...], Innovations]:
    """Returns a correction's estimate with the other explanations of the table, and with a covariance inflated by what
    has not fitted the model lately; its modes under its `prior` alone; and how well evidence has fitted."""
    last = state.correction
    now = state.stamp
    age = 0.0 if last is None else seconds(now, last.stamp)
    afresh = estimate.consistent and state.monitor.lost_at(now)  # found again
    watched = NO_INNOVATIONS if last is None or afresh else state.monitor.innovations
    watched = watched.after(age, state.touch.fingertips.fingers, estimate, prior)
    estimate = watched.covered(model, estimate, prior)
    modes = tuple(estimate.modes)
    table = state.belief.table
    if table is not None and table.alternatives is not None:
        estimate = table.alternatives.added(model, estimate)
    # An answer that contacts did not fit was called wrong before it moved.
    if last is not None and last.estimate.consistent and not state.slip.now.slipping:
        noise = state.belief.walked(now, last.stamp)
        watched = watched.moved(age, model, last.estimate, estimate, noise)
    return watched.inflated(estimate), modes, watched


def sigma(model: ObjectModel, state: TrackState) -> float:
    """Returns the largest standard deviation of the position of the object's middle [m]; infinite before a pose."""
    last = state.correction
    if last is not None:
        return math.sqrt(last.variance + state.belief.walked(state.stamp, last.stamp)[0])
    if state.estimate is None:
        return math.inf
    return math.sqrt(point_uncertainty(state.estimate, model, model.center_object)[1])


def judged(
    model: ObjectModel, state: TrackState, estimate: PoseEstimate, settings: TrackerSettings
) -> Monitor:
    """Returns the monitor after an update that led to an estimate: how far it can be trusted, and why not further."""
    known = state.monitor
    fits = estimate.consistent or known.fits_at == -math.inf
    known = replace(known, fits_at=state.stamp if fits else known.fits_at)
    lost = _lost(known, state.stamp, settings.lost_after)
    label: State = "tracking"
    reason = lost or _doubt(model, replace(state, monitor=known), estimate, settings.uncertain_position)
    if reason:
        label = "lost" if lost else "uncertain"
    return replace(known, label=label, reason=reason)


def _lost(known: Monitor, stamp: float, lost_after: float) -> str:
    """Returns why the object is lost; empty where it is not."""
    if known.measured_at == -math.inf:
        return "nothing was touched or seen yet"
    since = seconds(stamp, known.measured_at)
    if since > lost_after:
        return f"nothing touched and nothing seen for {since:.1f} s"
    if known.lost_at(stamp):
        since = seconds(stamp, known.fits_at)
        return _with(f"the contacts have fitted no pose for {since:.1f} s", known.innovations.touch)
    return ""


def _doubt(model: ObjectModel, state: TrackState, estimate: PoseEstimate, most: float) -> str:
    """Returns why the estimate is uncertain; empty where it is not. `most`: largest sigma of the position [m]."""
    known = state.monitor
    other = known.innovations.touch
    if known.failure is not None:
        return known.failure.reason
    slip = state.slip.now
    if slip.slipping:
        reason = "the object slips: every finger that holds it is at the limit of friction"
        return f"{reason}; {slip.doubt}" if slip.doubt else reason
    if not estimate.consistent:
        return _with("the contacts do not fit the object at its estimated pose", other)
    if unzeroed := ", ".join(state.touch.skin.unzeroed):
        return f"skin {unzeroed}: pressed since its first readings: its offset is unknown"
    evidence = "images" if len(state.images.rivals) else "touch"
    if doubt := state.weight.doubt or ambiguity(model, estimate, evidence):
        return doubt
    misfit = known.innovations.worst
    if state.correction is not None and misfit is not None:
        return _with(str(misfit), state.weight.elsewhere(estimate) if misfit.name == "weight" else other)
    if state.correction is None and not state.belief.vision.camera_from_palm.confirmed:
        return "nothing is touched: the pose is vision's"
    if (far := sigma(model, state)) > most:
        reason = f"the position is known to {1e3 * far:.0f} mm only"
        table = state.belief.table
        doubt = "" if table is None else table.doubt(estimate)
        return f"{reason}; the table: {doubt}" if doubt else reason
    return ""


def _with(reason: str, why: str) -> str:
    """Returns a reason, with what explains it, if anything does."""
    return f"{reason}: {why}" if why else reason
