"""A Bayesian estimate of the object's pose in the palm and of vision's constant bias, from vision alone.

State, 12 numbers: `T_palm_object` and a bias (6,), jointly Gaussian. Process: the pose does a random walk in the palm,
the bias is constant. Measurement: `z = bias ∘ (T_mount_palm T_palm_object) + noise`, where the mount is what the camera
is fixed to (world or palm). Pose and bias can be told apart once the palm has turned in the mount.

All measurements since the last restart are kept, at most `MOST_MEASUREMENTS`; those from nearly the same pose of the
palm are merged. Each new one starts a Gauss-Newton iteration to the maximum a posteriori, from the last solution. A
filter would keep derivatives from earlier estimates, and so separate pose and bias even without a turn of the palm: it
is overconfident (measured: χ² forty times too large).

Contacts are not measurements of this estimate: they stay the same while the hand holds still, and would be counted
again at every instant. Instead, each correction fuses them anew, with this estimate as its prior.

The computation is in `_kernels/posterior/pose_bias.py`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.posterior import pose_bias
from handsight._kernels.records import MEASUREMENT
from handsight.checks import MAX_DISTANCE, Array
from handsight.correction import PosePrior
from handsight.gaussian_pose import GaussianPose, kalman_update

MAX_PROPAGATION = 100.0
"""Variance at which process noise stops growing [m², rad²]: the object may be anywhere."""
MOST_MEASUREMENTS = 48
SAME_PALM = np.array([0.01, np.deg2rad(2.0)])
"""Measurements from poses of the palm nearer to each other than this are merged [m, rad]. Where more than
`MOST_MEASUREMENTS` remain, the two nearest ones are merged as well."""


def process_variance(process_noise: Array, seconds: float) -> Array:
    """Returns (6,) the variance of a random walk after `seconds`; `process_noise` (6,) is its variance per second."""
    return np.minimum(process_noise * seconds, MAX_PROPAGATION)


@dataclass(frozen=True, slots=True, eq=False)
class PoseAndBias:
    """A `PoseAndBias` is the object's pose and vision's constant bias, jointly Gaussian."""

    Ts: Array
    """(2, 4, 4): `T_palm_object` and `T_measured_true`."""
    covariance: Array
    """(12, 12) of the perturbations (δp, δθ) of the pose, along the palm's axes, and of the bias, along the mount's."""

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
        """Returns the state moved by a step (12,), with the same covariance."""
        return PoseAndBias(se3.moved(self.Ts, step.reshape(2, 6)), self.covariance)

    def updated(self, H: Array, residual: Array, noise: Array) -> "PoseAndBias":
        """Returns the state after a linear measurement; the arguments are those of `kalman_update` with n = 12."""
        step, covariance = kalman_update(self.covariance, H, residual, noise)
        return PoseAndBias(self.moved(step).Ts, covariance)

    def given_pose(self, T_palm_object: Array, information: Array) -> "PoseAndBias":
        """Returns the state after a correction whose prior was this state's pose.

        `T_palm_object` (4, 4) is the corrected pose, `information` (6, 6) that of contacts and prior together. Contacts
        measure the pose alone; the bias changes through its correlation with the pose.
        """
        P = self.covariance
        prior = np.linalg.inv(P[:6, :6])
        step = se3.difference(T_palm_object, self.T_palm_object)
        joint = np.linalg.inv(P)
        joint[:6, :6] += nearest_semidefinite(information - prior)
        covariance = np.linalg.inv(joint)
        moved = self.moved(np.concatenate([step, P[6:, :6] @ prior @ step]))
        return replace(moved, covariance=(covariance + covariance.T) / 2)

    def inflated(self, variance: Array) -> "PoseAndBias":
        """Returns the state with `variance` (6,) added to the pose's variances, up to `MAX_PROPAGATION`."""
        covariance = self.covariance.copy()
        variances = np.einsum("ii->i", covariance)[:6]  # a view of the diagonal
        variances += np.minimum(variance, np.maximum(MAX_PROPAGATION - variances, 0.0))
        return PoseAndBias(self.Ts, covariance)

    def spread(self, covariance: Array) -> "PoseAndBias":
        """Returns the state with `covariance` (6, 6) added to the pose's."""
        more = self.covariance.copy()
        more[:6, :6] += covariance
        return PoseAndBias(self.Ts, more)

    def transformed(self, T_new_old: Array) -> "PoseAndBias":
        """Returns the state after the palm moved by T_new_old (4, 4) while the object stayed in the world."""
        R = np.eye(12)
        R[:3, :3] = R[3:6, 3:6] = T_new_old[:3, :3]
        Ts = np.stack([T_new_old @ self.T_palm_object, self.T_measured_true])
        return PoseAndBias(Ts, R @ self.covariance @ R.T)


@dataclass(frozen=True, slots=True, eq=False)
class PoseBiasSmoother:
    """A `PoseBiasSmoother` is the posterior of pose and bias, given a prior and all poses from vision since then."""

    prior: PoseAndBias
    pivot: Array
    """(3,) the point about which the bias turns, in the mount's frame [m]; it is near the object."""
    solved: PoseAndBias
    """The posterior at the last measurement."""
    solved_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) `process_noise` at the last measurement."""
    process_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) variance of the object's random walk in the palm since the prior [m², rad²]."""
    measurements: NDArray[np.void] = field(default_factory=lambda: np.empty(0, dtype=MEASUREMENT))
    """(k,) MEASUREMENT, one row for each distinct pose of the palm, in the order of time."""

    @classmethod
    def from_prior(
        cls, T_palm_object: Array, pose_covariance: Array, bias_covariance: Array, pivot: Array
    ) -> "PoseBiasSmoother":
        """Returns the smoother that starts with a pose and a zero bias, independent of each other.

        Each has a covariance (6, 6); the bias turns about `pivot` (3,), in the mount's frame [m].
        """
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = pose_covariance, bias_covariance
        prior = PoseAndBias(np.stack([T_palm_object, np.eye(4)]), covariance)
        return cls(prior, np.array(pivot), solved=prior)

    @property
    def now(self) -> PoseAndBias:
        """The posterior propagated to now."""
        return self.solved.inflated(self.process_noise - self.solved_noise)

    @property
    def without_touch(self) -> PosePrior:
        """The pose without contacts, as the prior of a correction."""
        return PosePrior.trusted(self.solved.T_palm_object, self.now.covariance[:6, :6])

    @property
    def is_near(self) -> bool:
        """Whether the object is near enough to the palm for any hand."""
        x, y, z = self.solved.Ts[0, :3, 3].tolist()
        return bool(abs(x) <= MAX_DISTANCE and abs(y) <= MAX_DISTANCE and abs(z) <= MAX_DISTANCE)

    def inflated(self, variance: Array) -> "PoseBiasSmoother":
        """Returns the smoother after a step of the pose's random walk with `variance` (6,) [m², rad²]."""
        noise = np.minimum(self.process_noise + variance, MAX_PROPAGATION)
        return PoseBiasSmoother(
            self.prior, self.pivot, self.solved, self.solved_noise, noise, self.measurements
        )

    def restarted(self, prior: PoseAndBias) -> "PoseBiasSmoother":
        """Returns a smoother without measurements; `prior` must include what they have measured."""
        return PoseBiasSmoother(prior, self.pivot, solved=prior)

    def transformed(self, T_new_old: Array) -> "PoseBiasSmoother":
        """Returns the smoother after the palm moved by T_new_old (4, 4) while the object stayed in the world.

        Its measurements are as if all had been made from the new pose of the palm. The random walk is assumed to have
        the same variance along all axes.
        """
        measurements = self.measurements.copy()
        measurements["T_mount_palm"] = measurements["T_mount_palm"] @ se3.inverse(T_new_old)
        prior, solved = self.prior.transformed(T_new_old), self.solved.transformed(T_new_old)
        return replace(self, prior=prior, solved=solved, measurements=measurements)

    def updated(self, pose_mount_object: GaussianPose, T_mount_palm: Array) -> "PoseBiasSmoother":
        """Returns the smoother after vision measured a pose; the pose's covariance excludes the bias."""
        measurements = np.empty(len(self.measurements) + 1, dtype=MEASUREMENT)
        # NumPy copies structured rows ten times slower than plain ones.
        measurements.view(np.float64)[: -MEASUREMENT.itemsize // 8] = self.measurements.view(np.float64)
        measurements[-1] = self._measurement(pose_mount_object, T_mount_palm)
        count = pose_bias.merge(measurements, MOST_MEASUREMENTS, SAME_PALM, self.solved.Ts, self.pivot)
        return self._solved(measurements[:count])

    def informed(self, bias: GaussianPose) -> "PoseBiasSmoother":
        """Returns the smoother after a measurement of the bias itself (`PoseAndBias.T_measured_true`)."""
        residual = se3.difference(bias.T_a_b, self.prior.T_measured_true)
        return self.with_prior(self.prior.updated(np.eye(12)[6:], residual, bias.covariance))

    def with_prior(self, prior: PoseAndBias) -> "PoseBiasSmoother":
        """Returns the smoother of the same measurements with another prior."""
        if not len(self.measurements):
            return replace(self, prior=prior, solved=prior.inflated(self.solved_noise))
        return replace(self, prior=prior)._solved(self.measurements)

    def mahalanobis2(self, pose_mount_object: GaussianPose, T_mount_palm: Array) -> float:
        """Returns the squared Mahalanobis distance (χ² of six numbers) of a measurement from its prediction."""
        now, measured = self.now, np.empty(1, dtype=MEASUREMENT)
        measured[0] = self._measurement(pose_mount_object, T_mount_palm)
        return float(pose_bias.distance2(now.Ts, now.covariance, self.pivot, measured))

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) the object's pose in the mount that vision should measure, bias included."""
        T = np.empty((4, 4))
        pose_bias.expect(self.solved.Ts, self.pivot, np.array(T_mount_palm), T)
        return T

    def _measurement(self, pose: GaussianPose, T_mount_palm: Array) -> tuple[Array, Array, Array, Array]:
        """Returns the fields of a MEASUREMENT."""
        return T_mount_palm, pose.T_a_b, pose.covariance, self.process_noise

    def _solved(self, measurements: NDArray[np.void]) -> "PoseBiasSmoother":
        """Returns the smoother at the maximum a posteriori of its prior and these measurements."""
        noise, Ts, covariance = self.process_noise, self.solved.Ts.copy(), np.empty((12, 12))
        prior = self.prior
        if not pose_bias.smooth(prior.Ts, prior.covariance, self.pivot, measurements, Ts, covariance):
            raise np.linalg.LinAlgError("vision: expected positive definite covariances")
        since = measurements["process_noise"][-1]
        state = PoseAndBias(Ts, covariance).inflated(noise - since)
        return PoseBiasSmoother(prior, self.pivot, state, noise, noise, measurements)


def nearest_semidefinite(information: Array) -> Array:
    """Returns the nearest positive semidefinite matrix, in metres and radians of a hand-sized object (0.1 m)."""
    scale = np.array([1.0] * 3 + [0.1] * 3)
    values, vectors = np.linalg.eigh(information / scale[:, None] / scale)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * scale[:, None] * scale)
