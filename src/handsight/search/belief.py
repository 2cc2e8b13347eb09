"""What touches have told so far: particles, drawn anew from every contact and scored on the whole history."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PosePrior
from handsight.correction.modes import apart, distinct
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.search.area import Area
from handsight.search.proposals import places_about
from handsight.search.scores import contact_scores, free_score
from handsight.search.touch import Touch

DRAWN, KEPT = 8192, 1024
"""Poses that are looked at after a touch, and those of them that are kept."""
HOPELESS = 30.0
"""A pose that is less likely by so much than the best, as a logarithm, is not looked at further."""
MOVES = 8
"""Metropolis steps of every particle: each its own size, up to `STEP` of places [m, m, rad]."""
STEP = np.array([0.004, 0.004, np.deg2rad(4.0)])
MOST_MODES = 8
TRIED, FEWEST = 2048, 8
"""Places about a contact that are tried, and how many must be in the area, for it to be of the object."""
SURE, SURE_POSITION, SURE_ROTATION = 0.95, 0.006, float(np.deg2rad(4.0))
"""Share of all poses, and standard deviations of a mode [m], [rad], from which on it is grasped."""
ROUNDING = float(np.deg2rad(0.1))
"""A turn is never known better [rad]."""
SEEDS = 2**32


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """Poses within 15 mm and 20° of each other, modulo symmetry."""

    prior: PosePrior
    """Their mean and covariance in the world, with what is not known of the table."""
    weight: float
    """Their share of all."""

    @property
    def T_world_object(self) -> Array:
        """(4, 4) their mean."""
        return self.prior.T_palm_object

    @property
    def sure(self) -> bool:
        """Whether the object is in this mode, and that is narrow enough to grasp it."""
        variances = np.diag(self.prior.covariance)
        position, rotation = np.sqrt([variances[:2].sum(), variances[5]])
        return bool(self.weight > SURE and position < SURE_POSITION and rotation < SURE_ROTATION)


@dataclass(frozen=True, eq=False)
class Belief:
    """Where the object may stand, given every touch so far; equally likely poses, and what is to be said of them."""

    model: ObjectModel
    area: Area
    seed: int = 0
    """Of all that is drawn: the same touches make the same belief."""
    touches: tuple[Touch, ...] = ()
    places: Array = field(init=False)
    """(n, 4): x, y [m], turn about the vertical [rad], and which way to stand."""

    def __post_init__(self) -> None:
        """Before any touch; raises InvalidInput."""
        if not isinstance(self.model, ObjectModel) or not isinstance(self.area, Area):
            came = f"{type(self.model).__name__} and {type(self.area).__name__}"
            raise InvalidInput(f"belief: expected an ObjectModel and an Area, got {came}")
        checks.integer(self.seed, "belief.seed", SEEDS)
        rng = np.random.default_rng((self.seed, len(self.touches)))
        drawn = self._drawn(rng)
        kept = rng.choice(len(drawn[0]), KEPT, p=_normalised(drawn[1]))
        object.__setattr__(
            self, "places", self._moved(drawn[0][kept], rng) if self.touches else drawn[0][kept]
        )

    def after(self, touch: Touch) -> "Belief":
        """What is believed after one more touch; raises InvalidInput.

        A contact where the object can be nowhere in its area is of something else, and left out.
        """
        if not isinstance(touch, Touch):
            raise InvalidInput(f"touch: expected a Touch, got {type(touch).__name__}")
        contact = touch.contact_world
        if contact is not None and not self._explains(contact, touch.radius):
            touch = replace(touch, contact_world=None)
        return replace(self, touches=(*self.touches, touch))

    @cached_property
    def Ts_world_object(self) -> Array:
        """(n, 4, 4) equally likely poses."""
        return self.area.poses(self.model, self.places)

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Where the object may be, the likeliest first."""
        Ts = self.Ts_world_object
        order = np.argsort(-self._score(self.places), kind="stable")
        chosen = distinct(self.model, Ts, order, MOST_MODES)
        away = np.array([np.hypot(*_in_metres(self.model, Ts, Ts[i])) for i in chosen])
        mine = np.argmin(away, axis=0)
        found = [self._mode(Ts[i], Ts[mine == k]) for k, i in enumerate(chosen)]
        return tuple(sorted(found, key=lambda mode: -mode.weight))

    @property
    def pose(self) -> PosePrior:
        """The likeliest mode's mean, with its spread and the table's as covariance; in the world.

        What `Tracker` takes as a pose measurement in the world.
        """
        return self.modes[0].prior

    def _explains(self, contact: Contacts, radius: float) -> bool:
        """Whether the object, somewhere in its area, would be touched there."""
        rng = np.random.default_rng(self.seed)
        places = places_about(self.model, self.area, contact, radius, TRIED, rng)
        return bool(self.area.holds(places).sum() >= FEWEST)

    def _drawn(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Places (m, 4), and the logarithm (m,) of how much more often each should have been drawn.

        From the area, or where there is a contact from poses that have the surface there, each contact in turn: with
        densities q_a, a place drawn from any of them weighs p / Σ q_a (the balance heuristic, Veach and Guibas 1995).
        """
        met = [
            (touch.contact_world, touch.radius) for touch in self.touches if touch.contact_world is not None
        ]
        if not met:
            places = self.area.draw(DRAWN, rng)
            return places, free_score(self.model, self.touches, self.area.poses(self.model, places))
        n = DRAWN // len(met)
        places = np.vstack([places_about(self.model, self.area, *contact, n, rng) for contact in met])
        Ts = self.area.poses(self.model, places)
        by_contact = contact_scores(self.model, self.touches, self.area.table, Ts)
        score = by_contact.sum(axis=1) - np.logaddexp.reduce(by_contact, axis=1)
        score[~self.area.holds(places)] = -np.inf
        hopeful = score > score.max() - HOPELESS
        places, score = places[hopeful], score[hopeful]
        return places, score + free_score(self.model, self.touches, Ts[hopeful])

    def _score(self, places: Array) -> Array:
        """(n,) logarithm of how likely the whole history is at places (n, 4)."""
        Ts = self.area.poses(self.model, places)
        score = contact_scores(self.model, self.touches, self.area.table, Ts).sum(axis=1)
        score += free_score(self.model, self.touches, Ts)
        return np.where(self.area.holds(places), score, -np.inf)

    def _moved(self, places: Array, rng: np.random.Generator) -> Array:
        """The places after Metropolis steps: what was drawn often spreads out over what is as likely."""
        score = self._score(places)
        for _ in range(MOVES):
            size = STEP * rng.uniform(size=(len(places), 1)) ** 2
            tried = places.copy()
            tried[:, :3] += size * rng.normal(size=(len(places), 3))
            new = self._score(tried)
            better = np.log(rng.uniform(size=len(places))) < new - score
            places, score = np.where(better[:, None], tried, places), np.where(better, new, score)
        return places

    def _mode(self, T: Array, Ts: Array) -> Mode:
        """The mode of poses (n, 4, 4), some of them, about T."""
        equivalent = nearest(self.model.symmetries, Ts, T, self.model.radius)
        center, table = self.model.center_object[None], self.area.table
        shifts = se3.apply(equivalent, center)[:, 0] - se3.apply(T, center)
        off = np.hstack([shifts, se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)])
        mean = off.mean(axis=0)
        R, middle = se3.rotation_exp(mean[3:]) @ T[:3, :3], se3.apply(T, center)[0] + mean[:3]
        unknown = [0.0, 0.0, table.sigma_height, table.sigma_tilt, table.sigma_tilt, ROUNDING]
        at_middle = (off - mean).T @ (off - mean) / len(off) + np.diag(np.square(unknown))
        # From the middle of the object's bounds to its origin, which a covariance of a pose is of.
        arm = np.eye(6)
        arm[:3, 3:] = se3.skew(R @ self.model.center_object)
        T_mean = se3.compose(R, middle - R @ self.model.center_object)
        return Mode(PosePrior(T_mean, arm @ at_middle @ arm.T), len(Ts) / len(self.places))


def _normalised(score: Array) -> Array:
    """(n,) probabilities from logarithms."""
    p = np.exp(score - score.max())
    return np.asarray(p / p.sum())


def _in_metres(model: ObjectModel, Ts: Array, T: Array) -> tuple[Array, Array]:
    """(n,) how far poses are from one, modulo symmetry: shifts and turns, a radian as long as the radius [m]."""
    shift, turn = apart(model, Ts, T)
    return shift, model.radius * turn
