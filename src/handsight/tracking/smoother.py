"""A Bayesian estimate of the object's pose in the palm and of vision's errors, from vision alone.

State, 19 numbers, jointly Gaussian: `T_palm_object`, a constant bias (6,), a drift (6,) and a latency. Process: the
pose does a random walk in the palm, bias and latency are constant, and the drift is an Ornstein-Uhlenbeck process, an
error that images of nearly the same time share. Measurement: `z = bias ∘ (T_mount_palm(t - latency) T_palm_object) +
drift + noise`, where the mount is what the camera is fixed to (world or palm). Pose and bias can be told apart once the
palm has turned in the mount, the latency once it has moved.

All measurements since the last restart are kept, at most `MOST_MEASUREMENTS`; neighbours in time from nearly the same
pose of the palm are merged. Each new one starts a Gauss-Newton iteration to the maximum a posteriori, from the last
solution. A filter would keep derivatives from earlier estimates, and so separate pose and bias even without a turn of
the palm: it is overconfident (measured: χ² forty times too large).

Contacts are not measurements of this estimate: they stay the same while the hand holds still, and would be counted
again at every instant. Instead, each correction fuses them anew, with this estimate as its prior.

What vision should measure is computed in `tracking/pose_bias.py`.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import MAX_DISTANCE, Array
from handsight.correction import PosePrior
from handsight.gaussian_pose import GaussianPose, kalman_update
from handsight.tracking import pose_bias
from handsight.tracking.kernels.pose_bias import follow
from handsight.tracking.pose_bias import BIAS, INNOVATION, LATENCY, MEASUREMENT, POSES, Measurements

MAX_PROPAGATION = 100.0
"""Variance at which process noise stops growing [m², rad²]: the object may be anywhere."""
MOST_MEASUREMENTS = 48
SAME_PALM = np.array([0.01, np.deg2rad(2), 0.5])
"""Neighbours in time from poses of the palm nearer to each other than this are merged [m, rad], within so many
correlation times of the drift. Where more than `MOST_MEASUREMENTS` remain, the two nearest ones are merged as well."""
STEPS = 2  # for each new measurement; the error that they leave is removed with the next
NO_DRIFT = np.array([0.0, 0.0, 1.0])
EYE = np.eye(19)
RIDGE = 1e-14 * EYE[POSES, POSES]  # [m², rad²]: a bias may be known to be none


class Motion(NamedTuple):
    """How a palm moved when vision measured a pose, and how that measurement shares the drift."""

    twist: Array = np.zeros(6)
    """(6,) velocity of the palm's origin [m/s] and of its rotation [rad/s], along the mount's axes."""
    latency: float = 0.0
    """How long before the measurement's stamp the palm had the pose that is given with it [s]."""
    drift_gain: float = 1.0
    """Size of the drift in this measurement, relative to the usual."""


STILL = Motion()


def process_variance(process_noise: Array, seconds: float) -> Array:
    """Returns (6,) the variance of a random walk after `seconds`; `process_noise` (6,) is its variance per second."""
    return np.minimum(process_noise * seconds, MAX_PROPAGATION)


@dataclass(frozen=True, slots=True, eq=False)
class PoseAndBias:
    """The object's pose and vision's errors, jointly Gaussian."""

    Ts: Array
    """(2, 4, 4): `T_palm_object` and `T_measured_true`."""
    covariance: Array
    """(19, 19) of the perturbations (δp, δθ) of the pose, along the palm's axes, of the bias, along the mount's, and of
    `rest`."""
    rest: Array = field(default_factory=lambda: np.zeros(7))
    """(7,) vision's drift, a shift of the object's origin [m] and a turn [rad] along the mount's axes, and its latency
    [s]."""

    def __post_init__(self) -> None:
        """Completes a covariance (12, 12) of pose and bias by a drift and a latency that are known to be `rest`."""
        if len(self.covariance) < len(EYE):
            covariance = np.zeros_like(EYE)
            covariance[:12, :12] = self.covariance
            object.__setattr__(self, "covariance", covariance)

    @property
    def T_palm_object(self) -> Array:
        """(4, 4) the object's pose."""
        return np.asarray(self.Ts[0])

    @property
    def T_measured_true(self) -> Array:
        """(4, 4) the bias, from true points to measured ones, along the mount's axes, with the pivot as origin."""
        return np.asarray(self.Ts[1])

    @property
    def vision_bias(self) -> Array:
        """(6,) shift [m] and rotation [rad] of vision's poses about the pivot, along the mount's axes."""
        return np.concatenate([self.Ts[1, :3, 3], se3.rotation_log(self.Ts[1, :3, :3])])

    def moved(self, step: Array) -> "PoseAndBias":
        """Returns the state moved by a step (19,), with the same covariance."""
        Ts = se3.moved(self.Ts, step[:12].reshape(2, 6))
        return PoseAndBias(Ts, self.covariance, self.rest + step[12:])

    def updated(self, H: Array, residual: Array, noise: Array) -> "PoseAndBias":
        """Returns the state after a linear measurement of pose and bias; the arguments are those of `kalman_update`
        with n = 12."""
        step, covariance = kalman_update(self.covariance, H @ EYE[: H.shape[1]], residual, noise)
        return replace(self.moved(step), covariance=covariance)

    def given_pose(self, T_palm_object: Array, information: Array) -> "PoseAndBias":
        """Returns the state after a correction whose prior was this state's pose.

        `T_palm_object` (4, 4) is the corrected pose, `information` (6, 6) that of contacts and prior together. Contacts
        measure the pose alone; vision's errors change through their correlation with the pose.
        """
        P = self.covariance
        prior = np.linalg.inv(P[:6, :6])
        step = se3.difference(T_palm_object, self.T_palm_object)
        added = nearest_semidefinite(information - prior)
        covariance = P - P[:, :6] @ np.linalg.solve(np.eye(6) + added @ P[:6, :6], added) @ P[:6]
        moved = self.moved(np.concatenate([step, P[6:, :6] @ prior @ step]))
        return replace(moved, covariance=(covariance + covariance.T) / 2)

    def inflated(self, variance: Array) -> "PoseAndBias":
        """Returns the state with `variance` (6,) added to the pose's variances, up to `MAX_PROPAGATION`."""
        covariance = self.covariance.copy()
        variances = np.einsum("ii->i", covariance)[:6]  # a view of the diagonal
        variances += np.minimum(variance, np.maximum(MAX_PROPAGATION - variances, 0.0))
        return PoseAndBias(self.Ts, covariance, self.rest)

    def later(self, seconds: float, drift: Array) -> "PoseAndBias":
        """Returns the state with its drift so much later; `drift` (3,) is that of a `PoseBiasSmoother`."""
        if seconds == 0:
            return self
        return PoseAndBias(self.Ts, *pose_bias.drifted(self.covariance, self.rest, drift, seconds))

    def spread(self, covariance: Array) -> "PoseAndBias":
        """Returns the state with `covariance` (6, 6) added to the pose's."""
        more = self.covariance.copy()
        more[:6, :6] += covariance
        return PoseAndBias(self.Ts, more, self.rest)

    def transformed(self, T_new_old: Array) -> "PoseAndBias":
        """Returns the state after the palm moved by T_new_old (4, 4) while the object stayed in the world."""
        R = EYE.copy()
        R[:3, :3] = R[3:6, 3:6] = T_new_old[:3, :3]
        Ts = np.stack([T_new_old @ self.T_palm_object, self.T_measured_true])
        return PoseAndBias(Ts, R @ self.covariance @ R.T, self.rest)


@dataclass(frozen=True, slots=True, eq=False)
class PoseBiasSmoother:
    """The posterior of pose and vision's errors, given a prior and all poses measured later."""

    prior: PoseAndBias
    pivot: Array
    """(3,) the point about which the bias turns, in the mount's frame [m]; it is near the object."""
    solved: PoseAndBias
    """The posterior at the last measurement."""
    solved_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) `process_noise` at the last measurement."""
    process_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) variance of the object's random walk in the palm since the prior [m², rad²]."""
    measurements: Measurements = field(default_factory=lambda: np.empty(0, dtype=MEASUREMENT))
    """(k,) MEASUREMENT, one row for each distinct pose of the palm, in the order of time."""
    drift: Array = field(default_factory=lambda: NO_DRIFT)
    """(3,) variance of vision's drift, of a position [m²] and a rotation [rad²], and its correlation time [s]."""
    time: float = 0.0
    """Since the prior [s]."""
    solved_at: float = 0.0
    """`time` at the last measurement [s]."""
    reference: Array | None = None
    """(4, 4) T_mount_palm of the last measurement that the prior includes; None: it includes none."""

    @classmethod
    def from_prior(
        cls,
        T_palm_object: Array,
        pose_covariance: Array,
        bias_covariance: Array,
        pivot: Array,
        drift: Array = NO_DRIFT,
        latency: tuple[float, float] = (0.0, 0.0),
    ) -> "PoseBiasSmoother":
        """Returns the smoother that starts with a pose and a zero bias, independent of each other.

        Each has a covariance (6, 6); the bias turns about `pivot` (3,), in the mount's frame [m]. `latency` is
        vision's, with its standard deviation [s].
        """
        covariance = np.diag(np.repeat([0.0, drift[0], drift[1], latency[1] ** 2], [12, 3, 3, 1]))
        covariance[:6, :6], covariance[6:12, 6:12] = pose_covariance, bias_covariance
        prior = PoseAndBias(np.stack([T_palm_object, np.eye(4)]), covariance, latency[0] * EYE[18, 12:])
        return cls(prior, np.array(pivot), solved=prior, drift=np.array(drift))

    @property
    def now(self) -> PoseAndBias:
        """The posterior propagated to now."""
        now = self.solved.inflated(self.process_noise - self.solved_noise)
        return now.later(self.time - self.solved_at, self.drift)

    @property
    def without_touch(self) -> PosePrior:
        """The pose without contacts, as the prior of a correction."""
        now = self.now
        return PosePrior.trusted(now.T_palm_object, now.covariance[:6, :6])

    @property
    def is_near(self) -> bool:
        """Whether the object is near enough to the palm for any hand."""
        return bool((np.abs(self.solved.Ts[0, :3, 3]) <= MAX_DISTANCE).all())

    def inflated(self, variance: Array, seconds: float = 0.0) -> "PoseBiasSmoother":
        """Returns the smoother after a step of the pose's random walk with `variance` (6,) [m², rad²], which took so
        many seconds."""
        noise = np.minimum(self.process_noise + variance, MAX_PROPAGATION)
        return replace(self, process_noise=noise, time=self.time + seconds)

    def restarted(self, prior: PoseAndBias) -> "PoseBiasSmoother":
        """Returns a smoother without measurements; `prior` must include what they have measured."""
        reference = self.measurements["T_mount_palm"][-1] if len(self.measurements) else self.reference
        return PoseBiasSmoother(prior, self.pivot, solved=prior, drift=self.drift, reference=reference)

    def transformed(self, T_new_old: Array) -> "PoseBiasSmoother":
        """Returns the smoother after the palm moved by T_new_old (4, 4) while the object stayed in the world.

        Its measurements are as if all had been made from the new pose of the palm. The random walk is assumed to have
        the same variance along all axes.
        """
        measurements = self.measurements.copy()
        measurements["T_mount_palm"] = measurements["T_mount_palm"] @ se3.inverse(T_new_old)
        prior, solved = self.prior.transformed(T_new_old), self.solved.transformed(T_new_old)
        reference = None if self.reference is None else self.reference @ se3.inverse(T_new_old)
        return replace(self, prior=prior, solved=solved, measurements=measurements, reference=reference)

    def updated(
        self, pose_mount_object: GaussianPose, T_mount_palm: Array, motion: Motion = STILL
    ) -> "PoseBiasSmoother":
        """Returns the smoother after vision measured a pose; the pose's covariance excludes bias and drift."""
        measurements = np.empty(len(self.measurements) + 1, dtype=MEASUREMENT)
        measurements[:-1] = self.measurements
        measurements[-1] = self._measurement(pose_mount_object, T_mount_palm, motion)
        known = self.solved.Ts, self.latency, self.pivot, self.drift
        return self._solved(pose_bias.merged(measurements, MOST_MEASUREMENTS, SAME_PALM, *known))

    @property
    def latency(self) -> float:
        """How much older a pose from vision is than its stamp, as estimated [s]."""
        return float(self.solved.rest[6])

    def informed(self, bias: GaussianPose) -> "PoseBiasSmoother":
        """Returns the smoother after a measurement of the bias itself (`PoseAndBias.T_measured_true`)."""
        residual = se3.difference(bias.T_a_b, self.prior.T_measured_true)
        return self.with_prior(self.prior.updated(np.eye(12)[6:], residual, bias.covariance))

    def with_prior(self, prior: PoseAndBias) -> "PoseBiasSmoother":
        """Returns the smoother of the same measurements with another prior."""
        if not len(self.measurements):
            solved = prior.inflated(self.solved_noise).later(self.solved_at, self.drift)
            return replace(self, prior=prior, solved=solved)
        return replace(self, prior=prior)._solved(self.measurements)

    def mahalanobis2(
        self, pose_mount_object: GaussianPose, T_mount_palm: Array, motion: Motion = STILL
    ) -> float:
        """Returns the squared Mahalanobis distance (χ² of six numbers) of a measurement from its prediction."""
        now = self.now
        measured = np.empty(1, dtype=MEASUREMENT)
        measured[0] = self._measurement(pose_mount_object, T_mount_palm, motion)
        (rows,) = pose_bias.rows(now.Ts, now.rest[6], self.pivot, measured)
        return pose_bias.distance2(rows, pose_mount_object.covariance, now.rest, now.covariance)

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) the object's pose in the mount that vision should measure, with its bias but no drift."""
        return pose_bias.expected(self.solved.Ts, self.pivot, T_mount_palm)

    def _prior_at(self, state: PoseAndBias) -> tuple[Array, Array]:
        """Returns the step (19,) from a state to the prior, and the prior's covariance (19, 19) there.

        A prior that includes measurements knows best what vision sees, z: pose and bias can be exchanged for each
        other. How depends on the bias, which the prior knew less well. So the prior is a Gaussian of pose and z, whose
        derivatives are taken at the state, as those of later measurements are. Two different directions of exchange
        would seem to tell pose and bias apart.
        """
        prior = self.prior
        step = np.concatenate([*se3.difference(prior.Ts, state.Ts), prior.rest])
        step[LATENCY] -= state.rest[6]
        if self.reference is None:
            return step, prior.covariance.copy()
        seen = np.zeros(1, dtype=MEASUREMENT)
        seen["T_mount_palm"] = self.reference
        seen["T_mount_object"] = pose_bias.expected(prior.Ts, self.pivot, self.reference)
        (before,) = pose_bias.rows(prior.Ts, prior.rest[6], self.pivot, seen)
        (now,) = pose_bias.rows(state.Ts, state.rest[6], self.pivot, seen)
        to_bias = np.linalg.inv(now[:, BIAS])
        exchange = EYE.copy()
        exchange[BIAS, :6] = to_bias @ (before[:, :6] - now[:, :6])
        exchange[BIAS, BIAS] = to_bias @ before[:, BIAS]
        step[BIAS] = to_bias @ (now[:, INNOVATION] - now[:, :6] @ step[:6])
        return step, exchange @ prior.covariance @ exchange.T

    def _measurement(self, pose: GaussianPose, T_mount_palm: Array, motion: Motion) -> tuple[object, ...]:
        """Returns the fields of a MEASUREMENT."""
        twist, latency, gain = motion
        poses = T_mount_palm, pose.T_a_b, pose.covariance
        return *poses, self.process_noise, twist, latency, self.time, self.time, gain

    def _solved(self, measurements: Measurements) -> "PoseBiasSmoother":
        """Returns the smoother at the maximum a posteriori of its prior and these measurements; raises LinAlgError for
        covariances that are not positive definite.

        A step of Gauss-Newton is a Kalman filter over the measurements, with every derivative taken at one state. So
        the object's random walk since an older measurement is an error common to all that are as old, and measurements
        share vision's drift the more, the nearer they are in time.
        """
        state = self.solved
        walked = np.diff(measurements["process_noise"], axis=0, prepend=np.zeros((1, 6)))
        gaps = np.diff(measurements["time"], prepend=0.0)
        whitening = pose_bias.whitening(measurements["covariance"])
        for _ in range(STEPS):
            rows = whitening @ pose_bias.rows(state.Ts, state.rest[6], self.pivot, measurements)
            step, covariance = self._prior_at(state)
            follow(rows, walked, gaps, self.drift, step, covariance)
            rest = step[12:].copy()
            rest[6] += state.rest[6]
            state = PoseAndBias(se3.moved(state.Ts, step[POSES].reshape(2, 6)), covariance, rest)
            # A palm that turns fast turns by some radians a second.
            turned = max(np.linalg.norm(step[3:6]), np.linalg.norm(step[9:12]), abs(step[LATENCY]))
            left = step[POSES] @ np.linalg.solve(covariance[POSES, POSES] + RIDGE, step[POSES])
            # A step that turns by an angle leaves at most that fraction of itself: here a χ² of a hundredth of a
            # standard deviation, squared.
            if turned**2 * left < 1e-4:
                break
        last = measurements[-1]
        state = state.inflated(self.process_noise - last["process_noise"])
        state = state.later(self.time - last["time"], self.drift)
        return replace(
            self,
            measurements=measurements,
            solved=state,
            solved_noise=self.process_noise,
            solved_at=self.time,
        )


def nearest_semidefinite(information: Array) -> Array:
    """Returns the nearest positive semidefinite matrix, in metres and radians of a hand-sized object (0.1 m)."""
    scale = np.array([1.0] * 3 + [0.1] * 3)
    values, vectors = np.linalg.eigh(information / scale[:, None] / scale)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * scale[:, None] * scale)
