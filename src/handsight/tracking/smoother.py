"""A recursive Bayesian estimate of the object's pose in the palm and of vision's constant bias, from vision alone.

State, 12 numbers: `T_palm_object` and a bias (6,), jointly Gaussian. Process: the pose does a random walk in the palm,
the bias is constant. Measurement: `z = bias ∘ (T_mount_palm T_palm_object) + noise`, where the mount is what the camera
is fixed to (world or palm), so pose and bias become observable apart as the palm turns in the mount.

All measurements since the last restart are kept, at most `MOST_MEASUREMENTS`, merged where they are from nearly the
same palm, and the maximum a posteriori is solved for anew with each (Gauss-Newton, begun at the last answer). A filter
that keeps derivatives taken elsewhere than where it has moved to tells pose and bias apart without that turn, and is
overconfident (measured: χ² forty times too large).

Contacts are not measurements of this estimate: they say the same thing at every instant and would be counted again each
time. The correction fuses them with this estimate as its prior, afresh each time.

What is computed is in `_kernels/posterior/pose_bias.py`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.posterior import pose_bias
from handsight._kernels.records import MEASUREMENT
from handsight.checks import MAX_DISTANCE, Array
from handsight.correction import PosePrior
from handsight.tracking.propagation import MAX_PROPAGATION

MOST_MEASUREMENTS = 48
SAME_PALM = np.array([0.01, np.deg2rad(2.0)])
"""Measurements from palms nearer to each other [m], [rad] are merged; beyond MOST_MEASUREMENTS, the nearest ones."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseAndBias:
    """A `PoseAndBias` is the object's pose and vision's constant bias, jointly Gaussian."""

    Ts: Array
    """(2, 4, 4): `T_palm_object` and `T_measured_true`."""
    covariance: Array
    """(12, 12) of the perturbations (δp, δθ) of the pose, along the palm's axes, and of the bias, along the mount's."""

    @property
    def T_palm_object(self) -> Array:
        """(4, 4)."""
        return np.asarray(self.Ts[0])

    @property
    def T_measured_true(self) -> Array:
        """(4, 4) the bias: from where things are to where vision measures them, along the mount's axes, both about the
        pivot."""
        return np.asarray(self.Ts[1])

    @property
    def vision_bias(self) -> Array:
        """(6,): vision's poses are shifted by (0:3) [m] and turned by (3:6) [rad] about the pivot, along the mount's
        axes."""
        return np.concatenate([self.Ts[1, :3, 3], se3.rotation_log(self.Ts[1, :3, :3])])

    def moved(self, step: Array) -> "PoseAndBias":
        """Returns the value after a step (12,); the covariance stays."""
        return PoseAndBias(se3.moved(self.Ts, step.reshape(2, 6)), self.covariance)

    def difference(self, reference: "PoseAndBias") -> Array:
        """Returns (12,) the step δ with `reference.moved(δ) = self`."""
        return se3.difference(self.Ts, reference.Ts).reshape(12)

    def updated(self, H: Array, innovation: Array, noise: Array) -> "PoseAndBias":
        """Returns the value after a linear measurement of m numbers (Kalman's update).

        `H` (m, 12); `innovation` (m,): measured less expected; `noise` (m, m): its covariance.
        """
        P = self.covariance
        gain = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
        keep = np.eye(12) - gain @ H
        # Joseph's form stays positive semidefinite.
        after = keep @ P @ keep.T + gain @ noise @ gain.T
        return replace(self.moved(gain @ innovation), covariance=(after + after.T) / 2)

    def given_pose(self, T_palm_object: Array, information: Array) -> "PoseAndBias":
        """Returns the value given a correction's answer: a pose (4, 4), and the information (6, 6) of contacts and
        this prior together.

        Contacts inform the pose alone; what they say of the bias follows from the correlation of the two.
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
        """Returns the value with `variance` (6,) added to the pose's, as far as it says something."""
        covariance = self.covariance.copy()
        variances = np.einsum("ii->i", covariance)[:6]  # where they are, to be written to
        variances += np.minimum(variance, np.maximum(MAX_PROPAGATION - variances, 0.0))
        return PoseAndBias(self.Ts, covariance)

    def spread(self, covariance: Array) -> "PoseAndBias":
        """Returns the value with a covariance (6, 6) added to the pose's."""
        more = self.covariance.copy()
        more[:6, :6] += covariance
        return PoseAndBias(self.Ts, more)

    def transformed(self, T_new_old: Array) -> "PoseAndBias":
        """Returns the same in a palm that went elsewhere while the object stayed."""
        R = np.eye(12)
        R[:3, :3] = R[3:6, 3:6] = T_new_old[:3, :3]
        Ts = np.stack([T_new_old @ self.T_palm_object, self.T_measured_true])
        return PoseAndBias(Ts, R @ self.covariance @ R.T)


@dataclass(frozen=True, slots=True, eq=False)
class PoseBiasSmoother:
    """A `PoseBiasSmoother` is the posterior of pose and bias, given a prior and all measurements of vision since."""

    prior: PoseAndBias
    pivot: Array
    """(3,) about what the bias turns, in the mount's frame [m]: about here is the object."""
    solved: PoseAndBias
    """The posterior when the last measurement came."""
    solved_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) the process noise by then."""
    process_noise: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) variance of the object's random walk in the palm since the prior."""
    measurements: NDArray[np.void] = field(default_factory=lambda: np.empty(0, dtype=MEASUREMENT))
    """(k,) MEASUREMENT, a row for each palm they were taken from, in the order of time."""

    @classmethod
    def from_prior(
        cls, T_palm_object: Array, pose_covariance: Array, bias_covariance: Array, pivot: Array
    ) -> "PoseBiasSmoother":
        """Returns the smoother of a pose and a bias of mean zero, independent: a covariance (6, 6) each."""
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
        """Where the object is by all but touch."""
        return PosePrior.trusted(self.solved.T_palm_object, self.now.covariance[:6, :6])

    @property
    def is_near(self) -> bool:
        """Whether the object is anywhere that a hand could be."""
        x, y, z = self.solved.Ts[0, :3, 3].tolist()
        return bool(abs(x) <= MAX_DISTANCE and abs(y) <= MAX_DISTANCE and abs(z) <= MAX_DISTANCE)

    def inflated(self, variance: Array) -> "PoseBiasSmoother":
        """Returns the smoother after a step of the random walk of the pose, of `variance` (6,)."""
        noise = np.minimum(self.process_noise + variance, MAX_PROPAGATION)
        return PoseBiasSmoother(
            self.prior, self.pivot, self.solved, self.solved_noise, noise, self.measurements
        )

    def restarted(self, prior: PoseAndBias) -> "PoseBiasSmoother":
        """Returns a smoother from another prior, which holds all that is to be kept of the measurements so far."""
        return PoseBiasSmoother(prior, self.pivot, solved=prior)

    def transformed(self, T_new_old: Array) -> "PoseBiasSmoother":
        """Returns the same in a palm that went elsewhere while the object stayed: as if all measurements had been
        from there.

        The random walk is taken for as wide along all axes of the palm.
        """
        measurements = self.measurements.copy()
        measurements["T_mount_palm"] = measurements["T_mount_palm"] @ se3.inverse(T_new_old)
        prior, solved = self.prior.transformed(T_new_old), self.solved.transformed(T_new_old)
        return replace(self, prior=prior, solved=solved, measurements=measurements)

    def updated(self, T_mount_object: Array, covariance: Array, T_mount_palm: Array) -> "PoseBiasSmoother":
        """Returns the value after vision measured a pose; `covariance` (6, 6) of its own noise, along the mount's
        axes."""
        measurements = np.empty(len(self.measurements) + 1, dtype=MEASUREMENT)
        # NumPy copies structured rows ten times slower than plain ones.
        measurements.view(np.float64)[: -MEASUREMENT.itemsize // 8] = self.measurements.view(np.float64)
        measurements[-1] = T_mount_palm, T_mount_object, covariance, self.process_noise
        solved = self.solved
        count = pose_bias.merge(measurements, MOST_MEASUREMENTS, SAME_PALM, solved.Ts, self.pivot)
        return self._solved(measurements[:count])

    def informed(self, T_measured_true: Array, covariance: Array) -> "PoseBiasSmoother":
        """Returns the smoother after the bias itself was measured: (4, 4) as `PoseAndBias` has it; `covariance` (6,
        6) along the mount's axes."""
        H = np.eye(12)[6:]
        innovation = se3.difference(T_measured_true, self.prior.T_measured_true)
        prior = self.prior.updated(H, innovation, covariance)
        if not len(self.measurements):
            return replace(self, prior=prior, solved=prior.inflated(self.solved_noise))
        return replace(self, prior=prior)._solved(self.measurements)

    def mahalanobis2(self, T_mount_object: Array, covariance: Array, T_mount_palm: Array) -> float:
        """Returns squared Mahalanobis distance (χ², six degrees of freedom) of a measurement from its prediction."""
        now, measured = self.now, np.empty(1, dtype=MEASUREMENT)
        measured[0] = T_mount_palm, T_mount_object, covariance, self.process_noise
        return float(pose_bias.distance2(now.Ts, now.covariance, self.pivot, measured))

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) the pose that vision should measure, in the mount's frame; `T_mount_palm` (4, 4)."""
        T = np.empty((4, 4))
        pose_bias.expect(self.solved.Ts, self.pivot, np.array(T_mount_palm), T)
        return T

    def _solved(self, measurements: NDArray[np.void]) -> "PoseBiasSmoother":
        """Returns the maximum a posteriori of the prior and these measurements, begun at the last answer."""
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
