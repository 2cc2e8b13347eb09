"""Mass and centre of mass of the object in a hand, from the sum of its fingertips' loads: one linear estimate.

In the air the object's loads (f, t) on the tips, each at its sensor's origin s, add up to the object's weight.
With g = R_wpᵀ (gravity - acceleration), along the palm's axes and about its origin,

    F = Σ f = m g + ε_F,    T = Σ (t + s × f) = m c × g + ε_T.

Both are linear in (m, m c) and, to first order, in the unknowns that all instants have in common: joint offsets δq,
gravity's direction φ (where the world's z is not vertical, g turns by φ × g), the tips' biases b, and their gains γ: an
axis of a sensor that reads a share γ too much adds that share of its reading, so that a squeeze, whose true forces
balance, leaves a net force; and, where the loads fit no weight otherwise, a force that no sensor feels, as of a link
beside the tips, with its torque, both fixed in the palm. Each constant is one unknown, however many instants there are:
as noise, it would make the estimate from five orientations worse than that from three, with a smaller covariance.

Constants u with unit priors, whose derivatives are the columns C of all whitened rows, are the same as correlated noise
of the rows, of covariance I + C Cᵀ: that leaves a problem of (m, m c) alone, and its residuals tell u afterwards.

An earlier instant is carried along as the object moves in the grip (`object_motion`): T_now_then moves its points with
the tips, and c creeps by κ d in addition. So c = T_now_then c_then + κ d, which keeps the torque linear in (m, m c, κ)
to first order. The speed of creep, κ, is one more unknown that all instants have in common.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.modes import chi2_survival
from handsight.forces.loads import LoadSum
from handsight.gaussian_pose import kalman_update

SIGMA_REACH = 0.15
"""Prior sigma of the centre of mass about the middle of the loads, per axis [m]: all that is known of its height
along gravity while gravity has had only one direction."""
ACCELERATION_SHARE = 0.1  # sigma of an acceleration, as a share of it: arms lag, and hands bend
GYRATION = 0.05
"""Radius of gyration of objects: the torque of an angular acceleration is not subtracted, but is an error [m]."""
PASSES = 2
"""The effect of gravity's direction on the torque depends on m c, which only the second pass knows."""
UNFELT_REACH = 0.05  # sigma of the lever of a force that no sensor feels, from the middle of the loads [m]
MIN_P = 0.003  # with a smaller p-value, something else bears a part of the load, or adds to it
MIN_P_FIXED = 0.02  # the same for a wrench fixed in the palm, as of an object that leans on a link
UNOBSERVABLE = 1e-6  # share of the largest information below which a direction is unobservable


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """`Unknowns` are the robot's unknown constants while it weighs, independent Gaussians with mean zero."""

    joints: Array
    """(j, j) L, where L Lᵀ is the covariance of the joints' constant errors [rad], or [m] for prismatic joints."""
    biases: Array  # (6 t,) sigmas of the force [N] and torque [N m] of each tip's bias
    creep: float  # sigma of the speed at which contacts creep [m/(N s)]
    gravity: Array  # (3,) nominal gravity in the world [m/s²]
    sigma_gravity: float  # sigma of gravity's direction, about each axis [rad]
    gains: Array = field(default_factory=lambda: np.zeros(1))
    """(6 t,) sigmas of the relative errors of each tip's readings, one for each axis of its sensor; zero: none."""
    unfelt: float = 0.0
    """Sigma per axis of a force on the object that is fixed in the palm and that no sensor feels [N]."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """An object's mass and its centre of mass in the palm, jointly Gaussian."""

    mean: Array
    """(4,) mass [kg] and centre in the palm [m]."""
    covariance: Array  # (4, 4) of `mean`
    chi2: float  # sum of the squared whitened residuals
    freedom: int  # degrees of freedom of `chi2`
    p_fixed: float  # p-value of the hypothesis that there is no wrench that is fixed in the palm
    directions: int  # the number of directions of gravity in which it was weighed

    def given_mass(self, mass: float, sigma: float) -> "Weighing":
        """Returns the weighing after an independent measurement of the mass [kg], such as a declared one."""
        H = np.eye(1, 4)
        off = mass - self.mass
        step, covariance = kalman_update(self.covariance, H, np.array([off]), np.array([[sigma**2]]))
        chi2 = float(self.chi2 + off**2 / (self.covariance[0, 0] + sigma**2))
        mean = self.mean + step
        freedom = self.freedom + 1
        return replace(self, mean=mean, covariance=covariance, chi2=chi2, freedom=freedom)

    @property
    def mass(self) -> float:
        """[kg]"""
        return float(self.mean[0])

    @property
    def center_palm(self) -> Array:
        """(3,) [m]"""
        return self.mean[1:]

    @property
    def sigma_mass(self) -> float:
        """[kg]"""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def covariance_center(self) -> Array:
        """(3, 3) [m²]"""
        return self.covariance[1:, 1:]

    @property
    def p_value(self) -> float:
        """The probability that loads of a weight alone would leave larger residuals."""
        return chi2_survival(self.chi2, self.freedom)

    @property
    def consistent(self) -> bool:
        """Whether no test rejects that the loads are those of a weight."""
        return self.mass > 0 and self.p_value > MIN_P and self.p_fixed > MIN_P_FIXED


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """The load at an earlier instant, and how the object has moved in the palm since then."""

    load: LoadSum
    T_now_then: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) motion with the tips: a point of the object that was at p in the palm then is at T p now."""
    creep: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) motion (v, ω) by creep, for each m/(N s): p has moved by v + ω × p in addition."""
    sigma: float = 0.0  # standard deviation of the rest of the motion, per axis [m]

    def moved(self, T: Array, creep: Array, sigma: float) -> "Carried":
        """Returns the value after one more motion: T (4, 4) with the tips, creep (6,), sigma of the rest [m]."""
        return Carried(self.load, T @ self.T_now_then, self.creep + creep, float(np.hypot(self.sigma, sigma)))


def weigh(instants: Sequence[Carried], unknowns: Unknowns, start: Weighing | None = None) -> Weighing:
    """Returns the object's mass and its centre of mass in the palm, at the last of one or more instants.

    `start`: a weighing of a moment ago, about which the problem is linear enough for one pass. A mass below zero means
    that gravity has the wrong sign, or that the loads are not those of a weight.
    """
    last = instants[-1].load
    middle = last.middle_palm
    rough = float(np.linalg.norm(last.wrench[:3]) / np.linalg.norm(last.gravity))
    prior = np.hstack([-middle[:, None], np.eye(3)]) / (SIGMA_REACH * max(rough, 1e-3))
    if start is None or start.mass <= 0:
        mass = rough
        moment = rough * middle
        passes = PASSES
    else:
        mass = start.mass
        moment = start.mass * start.center_palm
        passes = 1
    for _ in range(passes):
        rows = _whitened(instants, unknowns, mass, moment)
        C = rows[:, 4:-7]
        rows = _uncorrelated(rows, np.eye(len(rows)) + C @ C.T)
        H = rows[:, :4]
        C = rows[:, 4:-7]
        y = rows[:, -7]
        fixed = rows[:, -6:]
        covariance = np.asarray(np.linalg.inv(H.T @ H + prior.T @ prior))  # c is near the loads
        x = covariance @ (H.T @ y)
        mass = float(x[0])
        moment = x[1:4]
    left = y - H @ x
    off = prior @ x
    # Constants with a prior cost no degree of freedom; of mass and moment (4), the prior covers three.
    chi2 = float(left @ left + off @ off)
    p_fixed = score_test(fixed, left, H, covariance)
    D = np.zeros((4, 4))  # of (m, c), from those of (m, m c)
    D[0, 0] = 1.0
    D[1:, 0] = -moment / mass**2
    D[1:, 1:] = np.eye(3) / mass
    mean = np.concatenate([[mass], moment / mass])
    return Weighing(mean, D @ covariance @ D.T, chi2, len(rows) - 1, p_fixed, len(instants))


def score_test(columns: Array, residuals: Array, H: Array, covariance: Array) -> float:
    """Returns the probability that columns (n, k), added to a linear problem, explain so much by chance (Rao 1948). The
    problem has the rows H (n, m), the whitened residuals (n,), and the `covariance` (m, m) of its solution."""
    score, normal_matrix = columns.T @ residuals, columns.T @ H
    values, vectors = np.linalg.eigh(columns.T @ columns - normal_matrix @ covariance @ normal_matrix.T)
    observable = values > UNOBSERVABLE * values[-1]
    chi2 = ((vectors.T @ score)[observable] ** 2 / values[observable]).sum()
    return chi2_survival(chi2, int(observable.sum()))


def _whitened(instants: Sequence[Carried], unknowns: Unknowns, mass: float, moment: Array) -> Array:
    """Returns the six whitened rows of each instant, linear at (m, m c) = (`mass`, `moment`).

    The columns are the derivatives by (m, m c, φ, κ, joints, biases, gains, unfelt), 4 + 3 + 1 + j + 12 t + 6, all but
    the first four in units of their sigmas; then the measured wrench (1), and the derivatives by a wrench fixed in the
    palm (6).
    """
    Ts, creep = np.array([each.T_now_then for each in instants]), np.array([each.creep for each in instants])

    def of_loads(name: str) -> Array:
        return np.array([getattr(each.load, name) for each in instants])

    Rt = Ts[:, :3, :3].swapaxes(1, 2)
    t = Ts[:, :3, 3:]
    moment = moment[:, None]
    n = len(instants)
    g = of_loads("gravity")
    by_bias = of_loads("by_bias")
    lever = se3.skew((Rt @ (moment - mass * t))[..., 0])
    G = se3.skew(g)
    tilted = -of_loads("R_palm_world") @ se3.skew(unknowns.gravity) * unknowns.sigma_gravity
    crept = mass * creep[:, :3, None] + se3.skew(creep[:, 3:]) @ moment  # m d
    rows = np.zeros((n, 6, 8))
    rows[:, :3, 0] = g
    rows[:, 3:, :1] = G @ (Rt @ t)
    rows[:, 3:, 1:4] = -G @ Rt
    rows[:, :3, 4:7] = mass * tilted
    rows[:, 3:, 4:7] = lever @ tilted
    rows[:, 3:, 7:] = G @ (Rt @ crept) * unknowns.creep
    # Force and torque are off by the same error of the acceleration.
    shaken = np.concatenate([mass * np.eye(3) + np.zeros((n, 1, 1)), lever], axis=1)
    shaken *= ACCELERATION_SHARE * of_loads("acceleration")[:, None, None]
    noise = of_loads("noise") + shaken @ shaken.swapaxes(1, 2)
    turning = mass * GYRATION**2 * of_loads("turning")[:, None, None]
    moved = mass * np.array([each.sigma for each in instants])[:, None, None]
    noise[:, 3:, 3:] += turning**2 * np.eye(3) + moved**2 * G @ G.swapaxes(1, 2)
    by_joints = of_loads("by_joint") @ unknowns.joints
    by_biases = by_bias * unknowns.biases
    by_gains = by_bias * (of_loads("readings") * unknowns.gains)[:, None]
    # In units of 1 N, and of the torque of 1 N at `sigma_reach`.
    fixed = np.diag(np.repeat([1.0, SIGMA_REACH], 3)) + np.zeros((n, 1, 1))
    unfelt = np.diag(np.repeat([1.0, UNFELT_REACH], 3))
    unfelt[3:, :3] = se3.skew(instants[-1].load.middle_palm)
    unfelt = unknowns.unfelt * unfelt + np.zeros((n, 1, 1))
    measured = of_loads("wrench")[..., None]
    rows = np.concatenate([rows, by_joints, by_biases, by_gains, unfelt, measured, fixed], axis=2)
    return _uncorrelated(rows, noise).reshape(6 * n, -1)


def _uncorrelated(rows: Array, covariance: Array) -> Array:
    """Returns rows (..., n, k) combined so that their noise, of `covariance` (..., n, n), has the identity's."""
    # For many columns NumPy's `solve` takes four times as long.
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) @ rows)
