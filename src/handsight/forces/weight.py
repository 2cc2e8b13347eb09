"""Mass and centre of mass of what a hand holds, from the sum of its fingertips' loads: one linear estimate.

In the air the tips' loads (f, t), of the object on each tip at its sensor's origin s, add up to the object's weight.
With g = R_wpᵀ (gravity - acceleration), in the palm's axes and about its origin,

    F = Σ f = m g + ε_F,    T = Σ (t + s × f) = m c × g + ε_T.

Both are linear in (m, m c) and, to first order, in what all instants share and is not known: joint offsets δq,
gravity's direction φ (a world off plumb: g turns by φ × g), and the tips' biases b. What is constant is one unknown,
however many instants there are: taken for noise, five orientations are worth less than three, and seem worth more.

An instant of earlier is carried through the grip (`odometry`): T_now_then brings what was at p then to where the tips
have taken it, and c creeps by κ d besides, so c = T_now_then c_then + κ d, which keeps the torque linear in (m, m c, κ)
to first order. How fast contacts creep, κ, is one more unknown that all instants share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from handsight import se3
from handsight.checks import Array
from handsight.forces.loads import LoadSum


class WeightOptions(NamedTuple):
    """`WeightOptions` say how mass and centre of mass are fitted to loads."""

    sigma_reach: float = 0.15
    """How far the centre of mass is from the middle of the loads, per axis: all that is known along gravity as long as
    that has had one direction [m].
    """
    acceleration_share: float = 0.1
    """Sigma of an acceleration as a part of it: an arm is not where it says, and hands bend."""
    gyration: float = 0.05
    """Of what a hand holds: the torque to turn it faster is not subtracted, but counts as this uncertain [m]."""
    passes: int = 2  # what gravity's direction does to the torque depends on m c: the second pass knows it
    min_p: float = 0.003
    """A fit less likely than this is none: something else bears part of the load, or adds to it."""
    min_p_fixed: float = 0.02
    """The same of a bias that is fixed in the palm, as what a link of the hand bears nearly is."""
    unobservable: float = 1e-6
    """In parts of what is known best: what the loads know so much less of may be anything."""


WEIGHT_FIT = WeightOptions()


FIXED = np.diag([1.0, 1.0, 1.0, WEIGHT_FIT.sigma_reach, WEIGHT_FIT.sigma_reach, WEIGHT_FIT.sigma_reach])
"""A wrench that is fixed in the palm: force [N], and torque that such a force has at `WEIGHT_FIT.sigma_reach`."""


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """An `Unknowns` is what is not known of a robot while it weighs, jointly Gaussian of mean zero."""

    joints: Array
    """(j, j) L, L Lᵀ the covariance of the joints' constant errors [rad], of slides [m]."""
    biases: Array
    """(6 t,) sigmas of the tips' biases, force [N] and torque [N m] of each."""
    creep: float
    """How fast contacts creep: sigma [m/(N s)]."""
    gravity: Array
    """(3,) in the world [m/s²]."""
    sigma_gravity: float
    """Of its direction, about each axis [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """A `Weighing` is what an object weighs, and where its centre of mass is in the palm, jointly with the joints'
    errors."""

    mean: Array
    """(4 + j,) mass [kg], centre [m], and by how much the joints read too much, as far as the loads tell [rad]."""
    joint_covariance: Array
    """(4 + j, 4 + j)"""
    chi2: float
    """Squared deviations of all that is not explained."""
    freedom: int
    """Degrees of freedom of that."""
    chance_fixed: float
    """That as much of it would seem to press from a place in the palm, if nothing did."""
    directions: int
    """Of gravity, in how many it was weighed."""

    def given_mass(self, mass: float, sigma: float) -> "Weighing":
        """Returns the same where the mass is known (Kalman's update) [kg]."""
        P = self.joint_covariance
        variance, off = P[0, 0] + sigma**2, mass - self.mass
        gain = P[:, 0] / variance
        mean, covariance, chi2 = (
            self.mean + gain * off,
            P - np.outer(gain, P[0]),
            self.chi2 + off**2 / variance,
        )
        return replace(
            self, mean=mean, joint_covariance=covariance, chi2=float(chi2), freedom=self.freedom + 1
        )

    @property
    def mass(self) -> float:
        """[kg]"""
        return float(self.mean[0])

    @property
    def center_palm(self) -> Array:
        """(3,) [m]"""
        return self.mean[1:4]

    @property
    def sigma_mass(self) -> float:
        """[kg]"""
        return float(np.sqrt(self.joint_covariance[0, 0]))

    @property
    def covariance_center(self) -> Array:
        """(3, 3) [m²]"""
        return self.joint_covariance[1:4, 1:4]

    @property
    def chance(self) -> float:
        """That loads of a weight alone would leave as much unexplained."""
        return float(chdtrc(self.freedom, self.chi2))

    @property
    def consistent(self) -> bool:
        """Whether the loads are those of a weight, as far as can be told."""
        return self.mass > 0 and self.chance > WEIGHT_FIT.min_p and self.chance_fixed > WEIGHT_FIT.min_p_fixed


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """A `Carried` is what tips bore a while ago, and what has become of the object in the palm since."""

    load: LoadSum
    T_now_then: Array
    """(4, 4): what was at p in the palm then is at T p now."""
    creep: Array
    """(6,) by how much more it has moved for each m/(N s) that its contacts creep: p by v + ω × p (v, ω)."""
    sigma: float
    """Of where it was carried, per axis [m]."""


def weigh(instants: Sequence[Carried], unknowns: Unknowns, start: Weighing | None = None) -> Weighing:
    """Returns the object's mass and centre of mass by all instants (one at least), in the palm of now, which the last
    is of.

    `start`: a weighing of a moment ago, about which it is as good as linear. A mass below zero says that gravity points
    the other way, or that the loads are no weight's.
    """
    last = instants[-1].load
    middle, rough = last.middle_palm, float(np.linalg.norm(last.wrench[:3]) / np.linalg.norm(last.gravity))
    prior = np.hstack([-middle[:, None], np.eye(3)]) / (WEIGHT_FIT.sigma_reach * max(rough, 1e-3))
    if start is None or start.mass <= 0:
        mass, moment, passes = rough, rough * middle, WEIGHT_FIT.passes
    else:
        mass, moment, passes = start.mass, start.mass * start.center_palm, 1
    for _ in range(passes):
        rows = np.concatenate([_whitened(instant, unknowns, mass, moment) for instant in instants])
        H, y, fixed = rows[:, :-7], rows[:, -7], rows[:, -6:]
        information = H.T @ H
        information[:4, :4] += prior.T @ prior  # c is near the loads
        information[4:, 4:] += np.eye(len(information) - 4)
        covariance = np.asarray(np.linalg.inv(information))
        x = covariance @ (H.T @ y)
        mass, moment = float(x[0]), x[1:4]
    left, off = y - H @ x, prior @ x[:4]
    chi2 = float(left @ left + off @ off + x[4:] @ x[4:])
    # Unknowns with a prior pay for themselves; of mass and moment, which are four, the prior above pays for three.
    mean, joint = _marginal(x, covariance, unknowns)
    chance = _chance(fixed, left, H, covariance)
    return Weighing(mean, joint, chi2, len(rows) - 1, chance, len(instants))


def _chance(columns: Array, left: Array, H: Array, covariance: Array) -> float:
    """Returns the chance that, for nothing, (n, k) more `columns` would explain as much of what is `left` (n,) (Rao's
    score)."""
    score, normal_matrix = columns.T @ left, columns.T @ H
    values, vectors = np.linalg.eigh(columns.T @ columns - normal_matrix @ covariance @ normal_matrix.T)
    observable = values > WEIGHT_FIT.unobservable * values[-1]
    return float(chdtrc(observable.sum(), ((vectors.T @ score)[observable] ** 2 / values[observable]).sum()))


def _marginal(x: Array, covariance: Array, unknowns: Unknowns) -> tuple[Array, Array]:
    """Returns mean (4 + j,) and covariance of (m, c, δq), from those of (m, m c, φ, κ, joints, biases)."""
    L = unknowns.joints
    mass, j = x[0], L.shape[1]
    center, chosen = x[1:4] / mass, [0, 1, 2, 3, *range(8, 8 + j)]
    D = np.zeros((4 + len(L), 4 + j))
    D[0, 0], D[1:4, 0], D[1:4, 1:4], D[4:, 4:] = 1.0, -center / mass, np.eye(3) / mass, L
    mean = np.concatenate([[mass], center, L @ x[8 : 8 + j]])
    return mean, D @ covariance[np.ix_(chosen, chosen)] @ D.T


def _whitened(instant: Carried, unknowns: Unknowns, mass: float, moment: Array) -> Array:
    """Returns (6, 4 + 3 + 1 + j + 6 t + 1 + 6) rows of an instant by (m, m c, φ, κ, joints, biases), all but the
    first four in their sigmas, their right side, and by what is fixed in the palm; linear at (m, m c) = (`mass`,
    `moment`)."""
    load, g = instant.load, instant.load.gravity
    R, t = instant.T_now_then[:3, :3], instant.T_now_then[:3, 3]
    G = se3.skew(g)
    moment_then = R.T @ (moment - mass * t)
    lever = se3.skew(moment_then)
    tilted = -load.R_palm_world @ se3.skew(unknowns.gravity) * unknowns.sigma_gravity
    crept = mass * instant.creep[:3] + se3.skew(instant.creep[3:]) @ moment  # m d
    rows = np.zeros((6, 8))
    rows[:3, 0], rows[3:, 0] = g, G @ (R.T @ t)
    rows[3:, 1:4] = -G @ R.T
    rows[:3, 4:7], rows[3:, 4:7] = mass * tilted, lever @ tilted
    rows[3:, 7] = G @ (R.T @ crept) * unknowns.creep
    noise = load.noise.copy()
    shaken = (
        WEIGHT_FIT.acceleration_share * load.acceleration * np.vstack([mass * np.eye(3), lever])
    )  # both by the same error
    noise += shaken @ shaken.T
    noise[3:, 3:] += (mass * WEIGHT_FIT.gyration**2 * load.turning) ** 2 * np.eye(3)
    noise[3:, 3:] += (mass * instant.sigma) ** 2 * G @ G.T
    rows = np.column_stack(
        [rows, load.by_joint @ unknowns.joints, load.by_bias * unknowns.biases, load.wrench, FIXED]
    )
    return np.asarray(np.linalg.solve(np.linalg.cholesky(noise), rows))
