"""The table as evidence of the object's pose: it rests on one of its sides, or it leans and the fingers hold it.

Until the palm lifts the object, one of several explanations is true, its `Support`: a resting pose on the table where
the rig says it is; the same on a table that is elsewhere; or none. Under a support, the height and the tilt of the
object are three numbers that are measured at the grasp, with the table's noise. They never enter the tracker's
smoother, which has vision alone, but that of the support, so that they can be withdrawn. The probability of a support
is its prior one, times the density of the three numbers under vision's pose, times that of all touch, weight included,
under the prior that it makes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.resting import RestingPose, resting_poses
from handsight.observation import seconds
from handsight.rig import Table
from handsight.tracking.hypotheses import Alternatives, log_evidence, normalised
from handsight.tracking.search import Solver
from handsight.tracking.smoother import PoseAndBias, PoseBiasSmoother

LEANS = 0.1  # probability that the object rests on no side of its own, but leans and is held
PROBABILITY_MISPLACED = 0.15  # probability that the table is not where the rig says
MISPLACED_HEIGHT = 10.0  # factor on the height's sigma if it is not
MISPLACED_TILT = 3.0  # factor on the tilt's
NEGLIGIBLE = 1e-3  # probability of a resting pose that is not compared again
LEAST_EVIDENCE = -10.0
"""Log density of touch under a support, relative to the best, that is not lowered further: a search may fail."""
ROUNDING = 1e-9  # a turn that is smaller has no axis [rad]
CERTAIN = 0.8  # probability of the likeliest support from which on the others are compared seldom
PERIOD = 3  # between two such comparisons [s]
DOUBT_PERIOD = 0.5  # the same while none is certain, or touch contradicts the likeliest [s]


MISPLACED = (MISPLACED_HEIGHT, MISPLACED_TILT)


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """One explanation of what bears the object until it is lifted."""

    pose: RestingPose | None
    """The side on which it rests; None: it leans, or is held."""
    factors: tuple[float, float]
    """On the table's sigmas of height and tilt: above 1 where the table is not where the rig says."""
    probability: float
    """Before anything was measured."""


def supports_of(poses: Sequence[RestingPose]) -> tuple[Support, ...]:
    """Returns all supports of an object with these resting poses; their probabilities sum to 1."""
    rests = 1 - LEANS
    wrong = PROBABILITY_MISPLACED
    some = [
        Support(pose, factors, rests * share * pose.probability)
        for factors, share in (((1.0, 1.0), 1 - wrong), (MISPLACED, wrong))
        for pose in poses
    ]
    return (*some, Support(None, (1.0, 1.0), 1 - sum(one.probability for one in some)))


Measured = tuple[Array, Array, Array]
"""k linear measurements of a state: H (k, 3, 12), residuals (k, 3) and the covariances (k, 3, 3) of their noise."""


@dataclass(frozen=True, slots=True)
class TableEstimate:
    """Where the table must be, as the object stood on it at the grasp, and whether it is used."""

    height: float
    """Of its top in the world, along +z [m]."""
    sigma_height: float
    """One standard deviation [m]; it grows with time, as the object may move in the hand."""
    tilt: float
    """Angle between the object's base and the table of the rig [rad]."""
    sigma_tilt: float
    """One standard deviation about each horizontal axis [rad]."""
    probability: float
    """That the object rests on one of its sides, on a table where the rig says it is."""
    reason: str
    """Why the table is doubted; empty where it is used."""


@dataclass(frozen=True, slots=True, eq=False)
class TableEvidence:
    """What the table tells of an object that was grasped on it."""

    model: ObjectModel
    table: Table
    supports: tuple[Support, ...]
    """Those that are compared; the last is that the object does not rest."""
    priors: tuple[PoseAndBias, ...]
    """By support, of the pose and vision's bias at the smoother's start."""
    T_world_palm: Array
    """(4, 4) when the object was last known to be on the table."""
    stamp: float
    """Of that instant [s]."""
    moved: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6) covariance of the object's motion in the palm since then, beside the random walk [m², rad²]."""
    probabilities: Array = field(default_factory=lambda: np.ones(1))
    """(k,) of the supports; from vision alone before the first comparison."""
    touch: Array | None = None
    """(k,) the log density of touch under each support, a mean over time; None before the first comparison."""
    compared_at: float = -math.inf
    """When they were last compared [s]."""
    alternatives: Alternatives | None = None
    """The explanations other than the likeliest, when they were last compared."""

    @property
    def best(self) -> int:
        """The number of the likeliest support."""
        return int(self.probabilities.argmax())

    def due(self, stamp: float, estimate: PoseEstimate, *, news: bool) -> bool:
        """Returns whether the supports are to be compared again: now and then, and more often while none is certain,
        while touch contradicts the likeliest, at whose prior it led to `estimate`, or where there is `news` of it."""
        fits = estimate.consistent and not estimate.outliers and estimate.weight_fits is not False
        certain = fits and not news and self.probabilities.max() > CERTAIN
        period = PERIOD if certain else DOUBT_PERIOD
        return len(self.supports) > 1 and seconds(stamp, self.compared_at) >= period

    def compared(
        self,
        vision: PoseBiasSmoother,
        likeliest: tuple[PoseEstimate, PosePrior],
        solver: Solver,
        drift: Array,
        stamp: float,
    ) -> tuple["TableEvidence", PoseEstimate, PosePrior]:
        """Returns the evidence after all supports were compared by touch, and estimate and prior of the likeliest one.

        `likeliest`: those of the one that was likeliest before; `solver` finds those of other priors; `drift` is that
        of `measured`. Raises Unfinished.
        """
        priors, estimates = [], []
        for i in range(len(self.supports)):
            here = i == self.best
            priors.append(likeliest[1] if here else self.smoother(vision, i).without_touch)
            estimates.append(likeliest[0] if here else solver.correct(priors[i]))
        fits = [estimate for estimate in estimates if estimate.consistent]
        if fits:  # what fits one may fit another, where a search has missed it
            start = fits[0].T_palm_object_maximum
            for i, (estimate, prior) in enumerate(zip(estimates, priors, strict=True)):
                if not estimate.consistent:
                    estimates[i] = solver.refine(prior, start) or estimate
        touch = np.array([log_evidence(self.model, *pair) for pair in zip(estimates, priors, strict=True)])
        # Where touch fits none, its noise is larger than expected, and it tells that much less.
        rows, chi2 = zip(*((e.answer["rows"], e.answer["chi2"]) for e in estimates), strict=True)
        touch = np.maximum(touch - touch.max(), LEAST_EVIDENCE) * min(1.0, max(rows) / min(chi2))
        if self.touch is not None:  # two instants are no independent measurements: their mean counts
            touch = (touch + self.touch) / 2
        now = vision.now
        measured = self.measured(now, self.supports, drift)
        shares = normalised(self.log_densities(now, measured) + touch)
        order = np.argsort(-shares, kind="stable")
        alternatives = Alternatives.of(self.model, [(float(shares[i]), estimates[i]) for i in order])
        after = replace(self, probabilities=shares, touch=touch, compared_at=stamp, alternatives=alternatives)
        return after, estimates[order[0]], priors[order[0]]

    def compared_as(self, other: "TableEvidence") -> "TableEvidence":
        """Returns the evidence with the comparison of an earlier one; unchanged where that is of another grasp."""
        if other.supports is not self.supports:
            return self
        return replace(
            self,
            probabilities=other.probabilities,
            touch=other.touch,
            compared_at=other.compared_at,
            alternatives=other.alternatives,
        )

    @classmethod
    def of(
        cls,
        model: ObjectModel,
        table: Table,
        supports: tuple[Support, ...],
        state: PoseAndBias,
        T_world_palm: Array,
        stamp: float,
    ) -> "TableEvidence":
        """Returns the evidence of an object that was just grasped; `state` is the smoother's start, without a table.

        Negligible resting poses are left out.
        """
        every = cls(model, table, supports, (state,) * len(supports), T_world_palm, stamp)
        measured = every.measured(state, supports)
        shares = normalised(every.log_densities(state, measured))
        kept = np.append(np.flatnonzero(shares[:-1] > NEGLIGIBLE), len(shares) - 1)
        return replace(
            every,
            supports=tuple(supports[i] for i in kept),
            priors=(*(state.updated(*(part[i] for part in measured)) for i in kept[:-1]), state),
            probabilities=shares[kept] / shares[kept].sum(),
        )

    def smoother(self, vision: PoseBiasSmoother, number: int | None = None) -> PoseBiasSmoother:
        """Returns the smoother of vision, given a support by its number (default: the likeliest)."""
        number = self.best if number is None else number
        return vision if self.supports[number].pose is None else vision.with_prior(self.priors[number])

    def restarted(self, vision: PoseBiasSmoother, moved: Array) -> "TableEvidence":
        """Returns the evidence after the object has moved in the palm, by a random step of covariance `moved` (6, 6),
        at which vision's smoother (as it was before) was restarted."""
        smoothers = [self.smoother(vision, number) for number in range(len(self.supports))]
        priors = tuple(each.now.spread(moved) for each in smoothers)
        return replace(self, priors=priors, moved=self.moved + moved)

    def transformed(self, T_new_old: Array, T_world_palm: Array) -> "TableEvidence":
        """Returns the evidence after the palm moved by T_new_old (4, 4), to its pose in the world (4, 4), while the
        object kept its height and tilt."""
        priors = tuple(prior.transformed(T_new_old) for prior in self.priors)
        moved = se3.rotate_covariance(T_new_old[:3, :3], self.moved)
        return replace(self, priors=priors, T_world_palm=T_world_palm, moved=moved)

    def informed(self, vision: PoseBiasSmoother, bias: GaussianPose) -> "TableEvidence":
        """Returns the evidence after vision's bias itself was measured (see `PoseBiasSmoother.informed`)."""
        return replace(self, priors=tuple(vision.with_prior(p).informed(bias).prior for p in self.priors))

    def measured(
        self, state: PoseAndBias, supports: Sequence[Support], drift: Array | float = 0.0
    ) -> Measured:
        """Returns three numbers as a linear measurement of a state, for each of the k supports on which the object
        rests: the height of the centre of mass [m], and two tilts [rad].

        `drift` (6,): variance of the object's random walk since it was on the table [m², rad²].
        """
        T = state.T_palm_object
        table = self.table
        up = self.T_world_palm[2, :3]
        R = T[:3, :3]
        across = se3.skew(up)
        rests = [(each.pose, each.factors) for each in supports if each.pose is not None]
        k = len(rests)
        near = {pose: pose.near(-up @ R) for pose, _ in rests}
        down = np.array([near[pose][0] for pose, _ in rests]).reshape(k, 3) @ R.T
        arms = np.array([pose.center_object for pose, _ in rests]).reshape(k, 3) @ R.T
        # The rotation that brings a side down, about two horizontal axes; a table does not measure the yaw.
        axes = np.linalg.svd(up[None])[2][1:]
        turns = -down @ across  # up x down
        sines = np.linalg.norm(turns, axis=1)
        angles = np.arctan2(sines, -down @ up)
        turns *= np.where(sines > ROUNDING, angles / np.maximum(sines, ROUNDING), 1.0)[:, None]
        H = np.zeros((k, 3, 12))
        residuals = np.empty((k, 3))
        H[:, 0, :3] = up
        H[:, 0, 3:6] = arms @ across
        H[:, 1:, 3:6] = axes
        heights = table.height + np.array([near[pose][1] for pose, _ in rests]) - self.T_world_palm[2, 3]
        residuals[:, 0] = heights - (T[:3, 3] + arms) @ up
        residuals[:, 1:] = turns @ axes.T
        # A covariance must be invertible.
        factors = np.array([factors for _, factors in rests]).reshape(k, 2)
        variances = (factors * np.maximum((table.sigma_height, table.sigma_tilt), 1e-5)) ** 2
        noise = H[:, :, :6] @ (self.moved + drift * np.eye(6)) @ H[:, :, :6].swapaxes(1, 2)
        noise[:, 0, 0] += variances[:, 0]
        # A direction that differs by d turns the object by d x up.
        by_side = axes @ across @ R
        spreads = np.array([near[pose][2] for pose, _ in rests]).reshape(k, 3, 3)
        noise[:, 1:, 1:] += variances[:, 1, None, None] * np.eye(2) + by_side @ spreads @ by_side.T
        return H, residuals, noise

    def estimated(self, estimate: PoseEstimate, drift: Array) -> TableEstimate | None:
        """Returns where the table must be, given the object's pose; None where no side of it may be on a table.

        `drift` is that of `measured`.
        """
        rests = [i for i, support in enumerate(self.supports) if support.pose is not None]
        if not rests:
            return None
        declared = sum(float(self.probabilities[i]) for i in rests if self.supports[i].factors == (1.0, 1.0))
        support = self.supports[max(rests, key=lambda i: self.probabilities[i])]
        covariance = np.zeros((12, 12))
        covariance[:6, :6] = estimate.bounded_covariance + self.moved + drift * np.eye(6)
        now = PoseAndBias(np.stack([estimate.T_palm_object, np.eye(4)]), covariance)
        (H,), (off,), _ = self.measured(now, [support])
        sigma = np.sqrt(np.einsum("ij,jk,ik->i", H, covariance, H))
        height = self.table.height - float(off[0])
        tilt = float(np.linalg.norm(off[1:]))
        doubt = self.doubt(estimate)
        return TableEstimate(height, float(sigma[0]), tilt, float(sigma[1:].max()), declared, doubt)

    def doubt(self, estimate: PoseEstimate) -> str:
        """Returns why the table is doubted, given the object's pose; empty where it is used."""
        best = self.supports[self.best]
        if best.pose is None:
            return "the object rests on none of its sides: it leans, or the hand holds it"
        if best.factors == (1.0, 1.0):
            return ""
        now = PoseAndBias(np.stack([estimate.T_palm_object, np.eye(4)]), np.zeros((12, 12)))
        off = 1000 * self.measured(now, [best])[1][0, 0]
        side = "below" if off > 0 else "above"
        return f"touch and vision have it {abs(off):.0f} mm {side} where the rig says"

    def log_densities(self, state: PoseAndBias, measured: Measured) -> Array:
        """Returns (k,) the log probability of each support by vision alone, up to a constant.

        `state` is vision's, without a table, and `measured` what the supports measure of it. An object that leans has
        its centre of mass at any height up to its diameter, and points in any direction.
        """
        H, residuals, noise = measured
        S = H @ state.covariance[:12, :12] @ H.swapaxes(1, 2) + noise
        chi2 = (residuals * np.linalg.solve(S, residuals[:, :, None])[:, :, 0]).sum(axis=1)
        log_densities = -0.5 * (chi2 + np.linalg.slogdet(2 * np.pi * S)[1])
        leans = -math.log(4 * np.pi * self.model.diameter)
        probabilities = np.array([support.probability for support in self.supports])
        return np.asarray(np.log(probabilities) + np.append(log_densities, leans))


def on_table(state: PoseAndBias, model: ObjectModel, table: Table, T_world_palm: Array) -> PoseAndBias | None:
    """Returns the state given that the object stands on the table as vision suggests; None where it likely does not."""
    supports = supports_of(resting_poses(model, model.center_of_mass))
    evidence = TableEvidence.of(model, table, supports, state, T_world_palm, 0.0)
    best = evidence.best
    return None if evidence.supports[best].pose is None else evidence.priors[best]
