"""Whether the object slips, over time: how near each finger's load is to the limit of friction.

A finger's ratio is √(f_t² + (τ / e)²) / (μ f_n), which is 1 on its limit surface. One finger at its limit does not make
the object slip: one that sticks holds the object in all six directions. So the object slips when the *least* ratio is
at the limit. It also slips where it turns about one finger while three or more others slide and bounce.

While it slips, contacts chatter: they stick, break and close again within milliseconds, and the tangential force
turns. A mean over vectors is then far within the limit, and so is one over ratios: a finger's ratio is therefore the
mean of the upper half of its last readings.
"""

import itertools
import math
import statistics
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from handsight.checks import Array
from handsight.forces.friction import FRICTION, Friction, Vector, joined
from handsight.forces.loads import LINK_TAXELS, LoadSensor, load_sensors
from handsight.rig import Rig


class SlipOptions(NamedTuple):
    """`SlipOptions` say when contacts slip, as thresholds on a finger's ratio."""

    begin_ratio: float = 0.98  # a slip begins when the least ratio is above this
    end_ratio: float = 0.97  # and ends when it has been below this for `min_hold`
    max_sigma: float = 0.25  # share of μ; where μ is less certain no slip is reported
    gain_sigmas: float = 2.0
    """A ratio of taxels may be higher than they read by so many standard deviations of their gain. That hides whether a
    finger rests just below its limit or slides; but loads at rest are constant, and those of a slide are not."""
    change_sigmas: float = 1.2  # of taxels' gain, by which loads that are not constant differ from their mean
    rest: float = 0.05  # time constant of that running mean [s]
    stick_ratio: float = 0.4  # a slip ends at once when a ratio is below this
    min_chatter: float = 0.08
    """A finger at its limit bounces if its normal force changes by this share of itself from one reading to the next;
    one that has come to rest at its limit after it slid does not."""
    min_bouncing: int = 3  # fewest such fingers that slip while one other finger sticks
    min_hold: float = 0.008  # at the limit of slipping, ratios fluctuate [s]
    window: float = 0.016  # of the readings from which a ratio is computed; two at least [s]
    ratio_sigma: float = 0.04
    """Readings are averaged only as far as a ratio's noise is above this: the upper half of several is above their true
    mean by 0.7 standard deviations."""
    time_constant: float = 0.01  # of the running mean of vectors from which friction is learnt [s]
    max_gap: float = 0.1  # between two readings: after a longer one the mean starts anew [s]
    min_force: float = 0.2  # normal force above which a finger's ratio counts [N]
    sure_force: float = 0.5  # normal force above which friction is learnt from the ratio [N]
    min_force_sigmas: float = 10.0  # the first is at least so many standard deviations of a reading
    sure_force_sigmas: float = 40.0  # the second is at least so many


SLIP = SlipOptions()

Load = list[float]  # tangential force (3), normal force, torque about the normal


class _Limits(NamedTuple):
    """The `_Limits` of what measures a load."""

    min_force: float  # normal force above which its ratio counts [N]
    sure_force: float  # the same above which friction is learnt from it [N]
    noise: float  # of its tangential load [N]
    gain: float
    """Relative error of its ratio; 0: of a six-axis sensor, which has the same gain at every place."""

    @classmethod
    def of(cls, sensor: LoadSensor) -> "_Limits":
        """Returns those of a load sensor."""
        sigma = float(sensor.sigma[0])
        least, sure = SLIP.min_force_sigmas * sigma, SLIP.sure_force_sigmas * sigma
        noise, gain = math.hypot(sigma, sensor.sigma[3] / FRICTION.torsion), sensor.sigma_gain * sensor.taxels
        return cls(max(SLIP.min_force, least), max(SLIP.sure_force, sure), noise, gain)

    @property
    def factor(self) -> float:
        """On its ratio: what taxels miss of a load changes with the place that is touched, so theirs is at the limit
        where it may be."""
        return 1 + SLIP.gain_sigmas * self.gain


class _Ratios(NamedTuple):
    """A `_Ratios` is a finger's load on its limit surface, and the ratios of the last readings, without μ."""

    tangential: float  # √(f_t² + (τ / e)²), averaged as far as its noise requires [N]
    normal: float  # the same of f_n [N]
    last: tuple[tuple[float, float, float], ...]
    """Ratios, stamps [s] and normal forces [N] of the last readings."""

    @property
    def chatter(self) -> float:
        """How much the normal force changes from one reading to the next, as a share of itself."""
        forces = [normal for *_, normal in self.last]
        if len(forces) < 2:
            return 0.0
        changes = sum(abs(after - before) for before, after in itertools.pairwise(forces)) / (len(forces) - 1)
        return changes * len(forces) / sum(forces)

    @property
    def upper(self) -> float:
        """The mean ratio of the upper half of the last readings, of two at least."""
        best = sorted(self.last, reverse=True)[: max(2, len(self.last) // 2)]
        return sum([each[0] for each in best]) / len(best)


@dataclass(frozen=True, slots=True)
class Slip:
    """A `Slip` says whether the object slips at one instant, and how near each finger is to slipping."""

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

    @property
    def least(self) -> float | None:
        """The least ratio, that of the finger that holds the object best; None where no ratio is known."""
        return min(self.ratios.values(), default=None)

    @property
    def pivots(self) -> bool:
        """Whether fewer than two fingers are below their limits: what one finger holds can turn about it, slowly."""
        holding = sum(ratio < SLIP.begin_ratio for ratio in self.ratios.values())
        return bool(self.ratios) and holding < 2


class SlipDetector:
    """A `SlipDetector` detects slips from loads over time.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig, friction: tuple[float, float] | None = None) -> None:
        """Starts without loads. `friction`: μ of the object and its standard deviation, None where it is unknown. Where
        the rig's fingers declare theirs, μ is each finger's, joined with the object's."""
        self.now = Slip()  # the value after the last update
        self._relative, prior = declared_friction(rig, friction)
        """By finger, its μ relative to the common one."""
        self.friction = Friction(*prior)
        self.stamp = self._at_limit = -math.inf
        """Stamps of the last update, and of the last one at the limit [s]."""
        skin = {LINK_TAXELS.format(surface.frame) for surface in rig.skin.values()}
        fingers = {finger.frame: name for name, finger in rig.fingers.items()}
        self._by_wrench = {sensor.name: _Limits.of(sensor) for sensor in load_sensors(rig, fingers.values())}
        taxels = {fingers.get(each.frame, each.name): each for each in load_sensors(rig, skin) if each.taxels}
        self._by_taxels = {name: _Limits.of(sensor) for name, sensor in taxels.items()}
        self._means: Mapping[str, Load] = {}  # by finger, the running mean of its load
        self._rests: Mapping[str, Load] = {}  # the same over `SLIP.rest`, of those with an error of gain
        self._ratios: Mapping[str, _Ratios] = {}  # by finger that touches, its last ratios

    def update(
        self,
        stamp: float,
        fingers: tuple[str, ...],
        loads: Array | None,
        sliding: Collection[str] = (),
        by_taxels: Collection[str] = (),
    ) -> Slip:
        """Returns whether the object slips at `stamp` [s]; an update not newer than the last one changes nothing.

        `loads` (n, 5) are those on `fingers`, or on other links' taxels, by the name of their load sensor; see
        `FingertipContacts.loads`; NaN where one does not measure its load. `sliding`: fingers of which other evidence
        tells that they slide; friction is learnt from them. `by_taxels`: fingers whose load is their taxels'.
        """
        if not stamp > self.stamp:
            return self.now
        since, self.stamp = stamp - self.stamp, stamp
        rows = {} if loads is None else dict(zip(fingers, loads.tolist(), strict=True))
        unmeasured = tuple([name for name, row in rows.items() if not math.isfinite(sum(row))])
        # A load without a normal force, or with NaN, has no ratio.
        usable = {name: row for name, row in rows.items() if row[3] > 0 and name not in unmeasured}
        by_wrench = self._by_wrench.keys() - by_taxels
        limits = {name: (self._by_wrench if name in by_wrench else self._by_taxels)[name] for name in usable}
        goes_on = since <= SLIP.max_gap
        self._means = _follow(self._means if goes_on else {}, usable, since / SLIP.time_constant)
        inexact = {name: row for name, row in usable.items() if limits[name].gain}
        self._rests = _follow(self._rests if goes_on else {}, inexact, since / SLIP.rest)
        mu = self.friction.coefficient
        last = self._ratios if goes_on else {}
        self._ratios = {
            name: _read(limits[name].noise, stamp, row, mu, last.get(name)) for name, row in usable.items()
        }
        sure = dict[str, Vector]()
        for name, (x, y, z, normal, torque) in self._means.items():
            if normal > limits[name].sure_force:
                scale = normal * self._relative.get(name, 1.0)
                sure[name] = x / scale, y / scale, z / scale, torque / FRICTION.torsion / scale
        gain = max((limit.gain for limit in limits.values()), default=0.0)
        self.friction.update(sure, since if goes_on else 0.0, sliding, gain)
        mu, sigma = self.friction.coefficient, self.friction.sigma
        ratios = dict[str, float]()
        for name, read in self._ratios.items():
            if mu is not None and self._means[name][3] > limits[name].min_force:
                ratios[name] = read.upper * limits[name].factor / (mu * self._relative.get(name, 1.0))
        # Hysteresis, in the ratio and in time.
        was, least = self.now, min(ratios.values(), default=0.0)
        known = mu is not None and sigma is not None and sigma <= SLIP.max_sigma * mu
        at_limit = least >= (SLIP.end_ratio if was.slipping else SLIP.begin_ratio) or self._bounces(ratios)
        if known and at_limit and any(self._changes(name, limits[name].gain) for name in ratios):
            self._at_limit = stamp
        holds_after = SLIP.min_hold if was.slipping else 0.0
        slipping = least >= SLIP.stick_ratio and stamp - self._at_limit <= holds_after
        began = stamp if slipping and not was.slipping else was.began
        ended = stamp if was.slipping and not slipping else was.ended
        self.now = Slip(slipping, ratios, mu, began, ended, sigma, unmeasured)
        return self.now

    def _changes(self, name: str, gain: float) -> bool:
        """Returns whether a finger's load changes by more than the error of its `gain`."""
        if not gain:
            return True
        now, rest = self._means[name], self._rests[name]
        return math.dist(now, rest) >= SLIP.change_sigmas * gain * math.hypot(*now)

    def _bounces(self, ratios: Mapping[str, float]) -> bool:
        """Returns whether all fingers but one are at their limit and bounce."""
        at_limit = [name for name, ratio in ratios.items() if ratio >= SLIP.begin_ratio]
        if len(at_limit) < max(SLIP.min_bouncing, len(ratios) - 1):
            return False
        return statistics.median(self._ratios[name].chatter for name in at_limit) >= SLIP.min_chatter


def _follow(before: Mapping[str, Load], rows: Mapping[str, Load], passed: float) -> Mapping[str, Load]:
    """Returns running means after new rows; `passed` is the time since the last ones, in time constants."""
    weight = 1 - math.exp(-passed)
    return {
        name: [mean + weight * (x - mean) for mean, x in zip(before.get(name, row), row, strict=True)]
        for name, row in rows.items()
    }


def _read(sigma: float, stamp: float, row: Load, mu: float | None, before: "_Ratios | None") -> "_Ratios":
    """Returns a finger's ratios with a new reading, whose tangential load has a noise of `sigma` [N]."""
    x, y, z, normal, torque = row
    tangential = math.hypot(x, y, z, torque / FRICTION.torsion)
    noise = sigma / normal
    # A running mean with weight w for the last reading has a variance smaller by w / (2 - w).
    wanted = (SLIP.ratio_sigma * (mu or 1.0)) ** 2
    weight = min(2 * wanted / (noise**2 + wanted), 1.0)
    last: tuple[tuple[float, float, float], ...] = ()
    if before is not None:
        tangential = before.tangential + weight * (tangential - before.tangential)
        normal = before.normal + weight * (normal - before.normal)
        last, first, old = before.last, stamp - SLIP.window - 1e-9, 0
        while old < len(last) - 1 and last[old][1] < first:
            old += 1
        last = last[old:]
    return _Ratios(tangential, normal, (*last, (tangential / normal, stamp, row[3])))


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
