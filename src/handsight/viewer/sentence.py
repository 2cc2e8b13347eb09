"""Why the state is what it is, in one sentence."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from handsight.correction import PoseEstimate
from handsight.viewer.moment import Moment

COUNTS = ("no", "a", "two", "three", "four", "five")
NO_TOUCH = "no finger touches"
NEAR_SLIP = 0.8
"""Share of what friction holds from which on it is worth a word."""
LIKELY = 0.02
"""Weight from which another pose is worth a word."""


def sentence(moment: Moment) -> str:
    """Returns the state, why it is no better, and what the answer rests on."""
    mentions_touch = "touched" in moment.reason and not moment.fingertips.fingers
    parts = [
        part
        for part in (moment.reason, *_grounds(moment))
        if part and not (mentions_touch and part == NO_TOUCH)
    ]
    return f"{moment.state.capitalize()}: {'; '.join(parts)}."


def _grounds(moment: Moment) -> Iterator[str]:
    estimate, fingers = moment.estimate, moment.fingertips.fingers
    if estimate is None:
        yield _touch(fingers, "")
        return
    yield _touch(fingers, " and fit the object" if estimate.consistent else "")
    least = moment.slip.least or 0.0
    if least >= NEAR_SLIP and not moment.slip.slipping:
        yield f"the grip uses {least:.0%} of what friction holds"
    if moment.outliers:
        yield f"{_listed(moment.outliers)} left out as wrong"
    known = f"the position is known to {1e3 * moment.sigma:.{0 if moment.sigma >= 0.01 else 1}f} mm"
    if math.isfinite(moment.sigma) and "known to" not in moment.reason:
        yield known
    if fingers and (left := open_directions(estimate)):
        yield f"touch leaves {left} open"
    others = [mode.weight for mode in estimate.hypotheses[1:] if mode.weight >= LIKELY]
    if others:
        yield f"another pose is likely by {others[0]:.0%}"


def _touch(fingers: Sequence[str], fit: str) -> str:
    if not fingers:
        return NO_TOUCH
    if len(fingers) == 1:
        return f"only {fingers[0]} touches"
    return f"{_listed(fingers)} touch{fit}"


def open_directions(estimate: PoseEstimate) -> str:
    """Returns what contacts leave open, in words; empty where they leave nothing."""
    rows = estimate.unobservable
    if len(rows) == 6:
        return "every direction"
    shifts = int(sum(np.linalg.norm(row[:3]) >= np.linalg.norm(row[3:]) for row in rows))
    counts = ((shifts, "slide"), (len(rows) - shifts, "turn"))
    return " and ".join(f"{COUNTS[n]} {name}{'s' * (n > 1)}" for n, name in counts if n)


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
