"""Names that a rig lacks, and values so large that they seem to be in a wrong unit."""

from collections import Counter
from collections.abc import Iterator
from math import hypot

import numpy as np

from handsight import checks
from handsight.errors import InvalidInput, InvalidObject
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig.rig import Rig

MAX_RANGE = 10
MAX_FORCE = 300
"""From a camera or the palm to the object [m], and on a fingertip [N]; above that, the unit seems to be wrong."""
LARGEST_HELD = 20
LEAST_REACH = 0.1
"""An object is at most so many times as large as the hand's reach, which is at least that [m]."""
MIN_SHARE = 0.1  # of a recording's observations with such values; fewer are outliers


class Units:
    """Finds values so large that they seem to be in a wrong unit, and names that the rig lacks."""

    def __init__(self, rig: Rig) -> None:
        self._topics = rig.topics
        self._count = 0
        self._beyond = Counter[str]()
        self._fingers = frozenset(rig.fingers)
        self._skin = frozenset(rig.skin)
        self._largest: dict[str, tuple[float, str]] = {}
        hand = rig.hand
        limits = zip(hand.joint_names, np.abs(hand.limits).max(axis=1).tolist(), strict=True)
        # The hand's file may limit a joint too narrowly, hence the margin of a radian.
        self._limits = [(n, m, 2 * m + 1) for n, m in limits if n in hand.moving and np.isfinite(m)]
        reading = rig.topics.joint_reading
        converts = reading is not None and reading.converts
        ranges = zip(hand.joint_names, hand.limits.tolist(), strict=True) if converts else ()
        self._ranges = {name: limits for name, limits in ranges if name in hand.moving}

    def check_names(self, observation: Observation) -> None:
        """Raises InvalidInput where an observation names a finger or a tactile array that the rig lacks."""
        for argument, given, known in (
            ("wrenches", observation.wrenches, self._fingers),
            ("contacts", observation.contacts, self._fingers),
            ("skin", observation.skin, self._skin),
        ):
            if not given.keys() <= known:
                name = next(name for name in given if name not in known)
                came = f"{checks.brief(name)!r}{checks.suggestion(str(name), known)}"
                raise InvalidInput(f"observation.{argument}: expected names of the rig, got {came}")

    def check(self, observation: Observation) -> None:
        """Raises InvalidInput for a value of a valid observation that seems to be in a wrong unit."""
        for _, what, _, text in self._found(observation):
            raise InvalidInput(f"observation: expected other units, got {what} at {text}")

    def put(self, observation: Observation) -> None:
        """Counts the values of a recorded observation that seem to be in a wrong unit."""
        self._count += 1
        for topic, name, value, text in (*self._found(observation), *self._converted(observation)):
            what = f"{topic}: {name}" if topic else name
            self._beyond[what] += 1
            if value > self._largest.get(what, (0.0, ""))[0]:
                self._largest[what] = value, text

    def _converted(self, observation: Observation) -> Iterator[tuple[str | None, str, float, str]]:
        """Yields the same for positions that the rig converts, and that are half of a joint's range beyond its limits.

        With the other sign, or counted from the other end, half of an opening or closing hand's positions are.
        """
        positions = observation.joint_positions or {}
        for name, (low, high) in self._ranges.items():
            position = positions.get(name, low)
            beyond = max(low - position, position - high)
            if beyond > (high - low) / 2:
                limits = f"{low:.4g} to {high:.4g}"
                text = f"{position:.4g} where its file limits it to {limits} (its scale, offset or place in names?)"
                yield self._topics.joint_states, f"converted joint {name!r}", beyond, text

    def _found(self, observation: Observation) -> Iterator[tuple[str | None, str, float, str]]:
        """Yields topic, name, absolute value and a text for each value that seems to be in a wrong unit."""
        positions = observation.joint_positions or {}
        for name, limit, most in self._limits:  # hinges turn by a radian or two
            value = abs(positions.get(name, 0.0))
            if not value > most:
                continue
            radians = np.deg2rad(value)
            meant = f"degrees? {radians:.3g} rad"
            if radians > 2 * limit:
                meant = f"{value / 1000:.3g} in thousandths? Counts need a scale in topics.joint_states"
            text = f"{value:.4g} where its file limits it to {limit:.4g} ({meant})"
            yield self._topics.joint_states, f"joint {name!r}", value, text
        for name, wrench in observation.wrenches.items():
            force = hypot(*np.asarray(wrench).tolist()[:3])
            if force > MAX_FORCE:
                yield None, f"finger {name}", force, f"{force:.4g} N (millinewtons? {force / 1000:.3g} N)"
        vision = observation.vision
        T_world_palm = observation.T_world_palm
        if vision is not None and (vision.frame != "world" or T_world_palm is not None):
            place = vision.T_frame_object[:3, 3]
            if vision.frame == "world" and T_world_palm is not None:
                place = place - T_world_palm[:3, 3]
            distance = float(np.linalg.norm(place))
            if distance > MAX_RANGE:
                text = f"{distance:.4g} m away (millimetres? {distance / 1000:.3g} m)"
                yield self._topics.vision, "poses", distance, text

    def sentences(self) -> list[str]:
        """Returns a sentence for each kind of value that was often above its limit, such as for all joints one."""
        often = [what for what, count in self._beyond.items() if count >= MIN_SHARE * self._count]
        kinds = dict[str, list[str]]()
        for what in often:
            kinds.setdefault(what.rpartition(" ")[0], []).append(what)
        sentences = list[str]()
        for alike in kinds.values():
            worst = max(alike, key=lambda what: self._largest[what][0])
            others = f"; and {len(alike) - 1} more like that" if len(alike) > 1 else ""
            sentences.append(f"{worst} up to {self._largest[worst][1]}{others}")
        return sentences


def check_held(rig: Rig, model: ObjectModel) -> None:
    """Raises InvalidObject for an object of a size that the rig's hand cannot hold, as of one in another unit."""
    hand = rig.hand
    at_zero = dict(zip(hand.joint_names, np.clip(0.0, *hand.limits.T).tolist(), strict=True))
    tips = hand.Ts_palm_tip(at_zero)[:, :3, 3]
    reach = float(np.linalg.norm(tips, axis=1).max(initial=0.0))
    largest = LARGEST_HELD * max(reach, LEAST_REACH)
    if model.diameter > largest:
        expected = f"expected an object of at most {largest:.2g} m, which the hand can hold"
        raise InvalidObject(
            f"object {model.name!r}: {expected}, got {model.diameter:.4g} m: in another unit? (scale)"
        )
