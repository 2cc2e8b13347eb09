"""Whether the object slips, over time: how near each finger's load is to the limit of friction.

A finger's ratio is √(f_t² + (τ / e)²) / (μ f_n), which is 1 on its limit surface. One finger at its limit does not make
the object slip: one that sticks holds the object in all six directions. So the object slips when the *least* ratio is
at the limit. It also slips where it turns about one finger while three or more others slide and bounce.

While it slips, contacts chatter: they stick, break and close again within milliseconds, and the tangential force
turns. A mean over vectors is then far within the limit, and so is one over ratios: a finger's ratio is therefore the
mean of the upper half of its last readings. It is at the limit where it may be within the noise of its force.
"""

import math
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from handsight.checks import Array
from handsight.forces.friction import Friction, joined
from handsight.forces.kernels.slip import follow_loads
from handsight.forces.kernels.slip_records import FRICTION, LOAD_LIMITS, LOAD_MEMORY, LOAD_READ, SLIP
from handsight.forces.loads import LINK_TAXELS, LoadSensor, load_sensors
from handsight.observation import seconds
from handsight.rig import Rig

EYE = np.eye(3)
TURN_SIGMAS = 3.0  # of a load's noise, by which it has turned; a load that rests has random turns of less
UNKNOWN_FRICTION = "friction is neither declared nor shown by the loads so far, so no slip is noticed"


@dataclass(frozen=True, slots=True)
class Slip:
    """Whether the object slips at one instant, and how near each finger is to slipping."""

    slipping: bool = False  # whether the object slips
    ratios: Mapping[str, float] = field(default_factory=dict)
    """By finger that holds the object, its ratio; empty before friction is known."""
    friction: float | None = None  # coefficient of friction; None before it was learnt
    began: float = -math.inf  # when the object began to slip, this time or the last [s]
    ended: float = -math.inf  # when the last slip ended [s]
    sigma_friction: float | None = None  # standard deviation of that coefficient; None where it is unknown
    unmeasured: tuple[str, ...] = ()
    """Fingers that touch, and taxels that are pressed, without a measurement of their force: of pressure alone, or at
    full scale. They are no evidence of a slip, and may hold the object while all others slip."""
    doubt: str = ""
    """Why it cannot be told whether the object slips: friction is unknown, or too uncertain for these loads."""

    @property
    def least(self) -> float | None:
        """The least ratio, that of the finger that holds the object best; None where no ratio is known."""
        return min(self.ratios.values(), default=None)

    @property
    def pivots(self) -> bool:
        """Whether fewer than two fingers are below their limits: what one finger holds can turn about it, slowly."""
        holding = sum(ratio < SLIP.end_ratio for ratio in self.ratios.values())
        return bool(self.ratios) and holding < 2


class SlipDetector:
    """Detects slips from loads over time.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig, friction: tuple[float, float] | None = None) -> None:
        """Starts without loads. `friction`: μ of the object and its standard deviation, None where it is unknown. Where
        the rig's fingers declare theirs, μ is each finger's, joined with the object's."""
        self.now = Slip()  # the value after the last update
        relative, prior = declared_friction(rig, friction)
        self.friction = Friction(*prior)
        self.stamp = self._at_limit = -math.inf  # stamps of the last update, and of the last at the limit [s]
        fingers = {finger.frame: name for name, finger in rig.fingers.items()}
        skin = {LINK_TAXELS.format(surface.frame) for surface in rig.skin.values()}
        by_wrench = {sensor.name: _limits(sensor) for sensor in load_sensors(rig, fingers.values())}
        taxels = {fingers[each.frame]: each for each in load_sensors(rig, skin) if each.taxels}
        by_taxels = {name: _limits(sensor) for name, sensor in taxels.items()}
        self._numbers = {name: i for i, name in enumerate({**by_wrench, **by_taxels})}
        """By finger, its number in the arrays below."""
        limits = [
            (*(first.get(name) or then[name]), relative.get(name, 1.0))
            for first, then in ((by_wrench, by_taxels), (by_taxels, by_wrench))
            for name in self._numbers
        ]
        self._limits = np.array(limits, dtype=LOAD_LIMITS)  # (2 m,) LOAD_LIMITS, as `follow_loads` takes them
        self._memory = np.zeros(len(self._numbers), dtype=LOAD_MEMORY)
        for name in LOAD_MEMORY.names or ():
            if name != "count":
                self._memory[name] = np.nan
        self._anchors = np.full((len(self._numbers), 5), np.nan)
        """By finger, LOAD_MEMORY's `anchor` along the world's axes, at the last turn of its load there."""

    def update(
        self,
        stamp: float,
        fingers: tuple[str, ...],
        loads: Array | None,
        by_taxels: Collection[str] = (),
        R_world_palm: Array = EYE,
    ) -> Slip:
        """Returns whether the object slips at `stamp` [s]; an update not newer than the last one changes nothing.

        `loads` (n, 5) are those on `fingers`, see `FingertipContacts.loads`; NaN where one does not measure its load.
        `by_taxels`: fingers whose load is their taxels'. `R_world_palm` (3, 3) tells turns of a load from those of the
        palm.
        """
        if not stamp > self.stamp:
            return self.now
        since = seconds(stamp, self.stamp)
        self.stamp = stamp
        fingers, loads = ((), np.empty((0, 5))) if loads is None else (fingers, loads)
        numbers = [self._numbers[name] for name in fingers]
        m = len(self._numbers)
        if by_taxels:
            numbers = [i + m * (name in by_taxels) for name, i in zip(fingers, numbers, strict=True)]
        self._memory = self._memory.copy()
        reads = np.empty(len(loads), dtype=LOAD_READ)
        friction = self.friction
        given = self._limits, np.array(numbers, dtype=np.int64), loads, stamp, since
        scale = friction.coefficient or 1.0
        news, kept_up, gain = follow_loads(*given, scale, friction.declared, self._memory, reads)
        rows = dict(zip(fingers, reads.tolist(), strict=True))
        read = zip(numbers, rows.values(), strict=True)
        turns = [row[3] for number, row in read if row[3] and self._turns(number, R_world_palm)]
        if turns or news:
            friction.update(turns, kept_up, gain)
        self.now = self._judged(rows, numbers, gain)
        return self.now

    def _judged(self, rows: Mapping[str, Sequence[float]], numbers: Sequence[int], gain: float) -> Slip:
        """Returns whether the object slips now, by what `follow_loads` has read of each finger, of these numbers, and
        by the largest error of their gains."""
        friction = self.friction
        unmeasured = tuple([name for name, row in rows.items() if not row[0]])
        # NaN does not equal itself.
        held = {name: row for name, row in rows.items() if row[1] == row[1]}
        mu = friction.coefficient
        if mu is None:
            return Slip(unmeasured=unmeasured, doubt=UNKNOWN_FRICTION if held else "")
        ratios = {name: row[1] / mu for name, row in held.items()}
        # Hysteresis, in the ratio and in time.
        was = self.now
        least = min(ratios.values(), default=0.0)
        highest = min((row[2] / mu for row in held.values()), default=0.0)
        limit = SLIP.end_ratio if was.slipping else SLIP.begin_ratio
        known = friction.declared or friction.certain
        at_limit = known and (highest >= limit or self._bounces(ratios))
        if at_limit and (gain == 0 or self._changes(tuple(rows), numbers, ratios)):
            self._at_limit = self.stamp
        holds_after = SLIP.min_hold if was.slipping else 0.0
        slipping = least >= SLIP.stick_ratio and seconds(self.stamp, self._at_limit) <= holds_after
        return Slip(
            slipping=slipping,
            ratios=ratios,
            friction=mu,
            began=self.stamp if slipping and not was.slipping else was.began,
            ended=self.stamp if was.slipping and not slipping else was.ended,
            sigma_friction=friction.sigma,
            unmeasured=unmeasured,
            doubt=_doubt(friction, highest),
        )

    def _turns(self, number: int, R_world_palm: Array) -> bool:
        """Returns whether a finger's load, which has turned in the palm, has turned in the world too, without getting
        longer: in a hand that turns, the weight of what it holds turns in the palm alone. Where friction is declared, a
        normal force that changes counts as well."""
        finger = number % len(self._memory)
        anchor = self._memory["anchor"][finger].copy()
        anchor[:3] = R_world_palm @ anchor[:3]
        before = self._anchors[finger]
        size = float(np.linalg.norm(before[:4]))
        longer = abs(float(np.linalg.norm(anchor[:4])) - size)
        away = float(np.linalg.norm(anchor[:4] - before[:4]))
        squeezed = self.friction.declared * abs(float(anchor[4] / before[4]) - 1)
        noise = float(self._limits["noise"][number] / anchor[4])
        rests = away <= max(FRICTION.min_turn * size, TURN_SIGMAS * noise)
        if rests and squeezed <= FRICTION.min_turn:
            return False
        self._anchors = self._anchors.copy()
        self._anchors[finger] = anchor
        # Without an earlier anchor the comparison is false.
        return longer <= FRICTION.max_radial * math.hypot(away, size * squeezed)

    def _changes(self, fingers: Sequence[str], numbers: Sequence[int], ratios: Collection[str]) -> bool:
        """Returns whether any finger's load changes by more than the error of its gain."""
        for name, number in zip(fingers, numbers, strict=True):
            gain = self._limits["gain"][number]
            one = self._memory[number % len(self._memory)]
            limit = SLIP.change_sigmas * gain * np.linalg.norm(one["mean"])
            if name in ratios and (not gain or np.linalg.norm(one["mean"] - one["rest"]) >= limit):
                return True
        return False

    def _bounces(self, ratios: Mapping[str, float]) -> bool:
        """Returns whether all fingers but one are at their limit and bounce: half of their normal forces change much
        from one reading to the next, as a share of themselves."""
        at_limit = [name for name in ratios if ratios[name] >= SLIP.end_ratio]
        if len(at_limit) < max(SLIP.min_bouncing, len(ratios) - 1):
            return False
        memory = self._memory[[self._numbers[name] for name in at_limit]]
        forces = [one["last"][: one["count"], 2] for one in memory]
        chatter = [np.abs(np.diff(f)).mean() / f.mean() if len(f) > 1 else 0.0 for f in forces]
        return statistics.median(chatter) >= SLIP.min_chatter


def _doubt(friction: Friction, ratio: float) -> str:
    """Returns why the least ratio of the fingers does not tell whether the object slips; empty where it does."""
    if friction.certain or friction.sigma is None or friction.coefficient is None:
        return ""
    share = friction.sigma / friction.coefficient
    if ratio < 1 - share:
        return ""
    if not friction.declared:
        return UNKNOWN_FRICTION
    return f"friction is known within {share:.0%} only, and the loads are nearer to its limit than that"


def _limits(sensor: LoadSensor) -> tuple[float, float, float, float]:
    """Returns the fields of a load sensor's LOAD_LIMITS, without its friction."""
    sigma = float(sensor.sigma[0])
    least, sure = SLIP.min_force_sigmas * sigma, SLIP.sure_force_sigmas * sigma
    noise = math.hypot(sigma, sensor.sigma[3] / FRICTION.torsion)
    gain = sensor.sigma_gain * sensor.taxels
    return max(SLIP.min_force, least), max(SLIP.sure_force, sure), noise, gain


def declared_friction(
    rig: Rig, friction: tuple[float, float] | None
) -> tuple[dict[str, float], tuple[float, float] | tuple[()]]:
    """Returns by finger its μ relative to the common one, and the common μ with its sigma, empty where none is known.

    A finger without one, and taxels, have the object's, or the mean of the others. Sigmas are combined as those of one
    measurement each of the logarithm of μ.
    """
    fingers = {name: each.friction for name, each in rig.fingers.items() if each.friction is not None}
    if not fingers:
        return {}, friction or ()
    # The fingers' common error, as of the object's surface, is that of one of them.
    mu = math.exp(sum(map(math.log, fingers.values())) / len(fingers))
    squares = sum((rig.fingers[name].sigma_friction / value) ** 2 for name, value in fingers.items())
    prior = mu, mu * math.sqrt(squares / len(fingers))
    relative = {name: value / mu for name, value in fingers.items()}
    return relative, prior if friction is None else joined([prior, friction])
