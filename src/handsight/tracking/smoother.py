"""What is believed of the object before anything is touched: its pose in the palm and vision's constant error.

Vision sees `E T_mount_palm T_palm_object`: the object is fixed in the palm, the error E in the frame the camera is
fixed to, so they come apart as the palm turns. A filter that takes derivatives where it has moved to since would tell
them apart without that, and be sure of what it cannot know (measured: χ² forty times too large); so the sights are
kept, few and merged, and the twelve numbers are solved for anew with each.

Contacts are not in here: they say the same thing at every instant and would be counted again each time. They are laid
on top, afresh, by the correction.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array

MOST_SIGHTS = 48
NEAR_PALM = (0.01, np.deg2rad(2.0))
"""Sights from palms so near to each other [m], [rad] are merged; beyond MOST_SIGHTS, the nearest ones."""
STEPS = 2
"""Gauss-Newton steps for each sight; what they leave comes with the next."""
SMALL = 1e-4
"""χ² of the last step: a hundredth of a standard deviation."""
EYE_6 = np.eye(6)
TURN = 0.1
"""A radian counts as much as this length [m] when palms are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A pose and an error of vision, jointly Gaussian."""

    T_palm_object: Array
    """(4, 4)."""
    error: Array
    """(6,) by which vision is wrong: what it sees turned by (3:6) [rad] about the pivot, then shifted by (0:3) [m]."""
    covariance: Array
    """(12, 12) of the pose's perturbation (δp, δθ) along the palm's axes, and of the error's."""

    def moved(self, step: Array) -> "Joint":
        """After a step (12,); the covariance stays."""
        return Joint(se3.moved(self.T_palm_object, step[:6]), turned(self.error, step[6:]), self.covariance)

    def less(self, other: "Joint") -> Array:
        """(12,) the step that leads from the other here."""
        turn = se3.rotation_exp(self.error[3:]) @ se3.rotation_exp(other.error[3:]).T
        return np.concatenate(
            [
                se3.difference(self.T_palm_object, other.T_palm_object),
                self.error[:3] - other.error[:3],
                se3.rotation_log(turn),
            ]
        )

    def measured(self, H: Array, residual: Array, covariance: Array) -> "Joint":
        """After a measurement of m numbers: `H` (m, 12), what was measured less what was expected (m,), its noise."""
        P = self.covariance
        gain = np.linalg.solve(H @ P @ H.T + covariance, H @ P).T
        keep = np.eye(12) - gain @ H
        # Joseph's form stays positive semidefinite.
        after = keep @ P @ keep.T + gain @ covariance @ gain.T
        return replace(self.moved(gain @ residual), covariance=(after + after.T) / 2)

    def touched(self, T_palm_object: Array, information: Array) -> "Joint":
        """Given a corrected pose, `information` (6, 6) being that of touch and this belief together.

        Touch informs the pose alone; what it says of the error follows from how the two hang together.
        """
        P = self.covariance
        prior = np.linalg.inv(P[:6, :6])
        shift = se3.difference(T_palm_object, self.T_palm_object)
        joint = np.linalg.inv(P)
        joint[:6, :6] += positive(information - prior)
        covariance = np.linalg.inv(joint)
        error = turned(self.error, P[6:, :6] @ prior @ shift)
        return Joint(T_palm_object, error, (covariance + covariance.T) / 2)

    def walked(self, variance: Array) -> "Joint":
        """With `variance` (6,) added to the pose's."""
        covariance = self.covariance.copy()
        covariance[range(6), range(6)] += variance
        return replace(self, covariance=covariance)

    def carried(self, T_new_old: Array) -> "Joint":
        """In a palm that went elsewhere while the object stayed."""
        R = np.eye(12)
        R[:3, :3] = R[3:6, 3:6] = T_new_old[:3, :3]
        return Joint(T_new_old @ self.T_palm_object, self.error, R @ self.covariance @ R.T)


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Where vision saw the object, a row for each palm it saw it from; a row may be several looks merged."""

    Ts_mount_palm: Array
    """(k, 4, 4)."""
    Ts_mount_object: Array
    """(k, 4, 4)."""
    covariances: Array
    """(k, 6, 6) of their noise, along the mount's axes."""
    walks: Array
    """(k, 6) how far the object had walked in the palm by then, as variance since the prior."""

    def __len__(self) -> int:
        return len(self.walks)

    def with_row(self, k: int, row: tuple[Array, Array, Array, Array]) -> "Sights":
        """With row k replaced, or with one more where k is their number."""
        columns = (self.Ts_mount_palm, self.Ts_mount_object, self.covariances, self.walks)
        return Sights(
            *(
                np.concatenate([old[:k], new[None], old[k + 1 :]])
                for old, new in zip(columns, row, strict=True)
            )
        )


NO_SIGHTS = Sights(np.empty((0, 4, 4)), np.empty((0, 4, 4)), np.empty((0, 6, 6)), np.empty((0, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A prior, and all sights since."""

    now: Joint
    """The prior and the sights together."""
    prior: Joint
    pivot: Array
    """(3,) in the mount's frame: about here is the object [m]."""
    sights: Sights = NO_SIGHTS
    walk: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) how far the object has walked in the palm since the prior, as variance."""

    @classmethod
    def begun(cls, T_palm_object: Array, pose: Array, error: Array, pivot: Array) -> "Belief":
        """From a pose's covariance (6, 6) and the constant error's (6, 6), the two independent."""
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = pose, error
        joint = Joint(T_palm_object, np.zeros(6), covariance)
        return cls(joint, joint, pivot)

    @property
    def T_palm_object(self) -> Array:
        """(4, 4)."""
        return self.now.T_palm_object

    @property
    def pose_covariance(self) -> Array:
        """(6, 6) of (δp, δθ)."""
        return self.now.covariance[:6, :6]

    @property
    def T_seen_true(self) -> Array:
        """(4, 4) that maps where things are to where vision sees them, in the mount's frame."""
        return displaced(self.now.error, self.pivot, np.eye(4))

    def walked(self, variance: Array) -> "Belief":
        """After the object may have crept in the palm by `variance` (6,)."""
        return replace(self, now=self.now.walked(variance), walk=self.walk + variance)

    def settled(self, joint: Joint) -> "Belief":
        """What is believed now as the prior of what comes: where the sights so far say no more than this."""
        return Belief(joint, joint, self.pivot)

    def carried(self, T_new_old: Array) -> "Belief":
        """In a palm that went elsewhere while the object stayed: as if all sights had been from there."""
        T_old_new = se3.inverse(T_new_old)
        sights = replace(self.sights, Ts_mount_palm=self.sights.Ts_mount_palm @ T_old_new)
        return replace(
            self, now=self.now.carried(T_new_old), prior=self.prior.carried(T_new_old), sights=sights
        )

    def seen(self, T_mount_object: Array, covariance: Array, T_mount_palm: Array) -> "Belief":
        """After a sight of the object there; `covariance` (6, 6): its own noise, along the mount's axes."""
        return self._solved(self._merged(T_mount_palm, T_mount_object, covariance))

    def surprise(self, T_mount_object: Array, covariance: Array, T_mount_palm: Array) -> float:
        """χ² (six degrees of freedom) of seeing the object there."""
        Ts = T_mount_palm[None]
        H, residual = self._sighting(self.now, Ts, T_mount_object[None])
        S = H[0] @ self.now.covariance @ H[0].T + covariance
        return float(residual[0] @ np.linalg.solve(S, residual[0]))

    def expected(self, T_mount_palm: Array) -> Array:
        """(4, 4) where vision should see the object, in the mount's frame."""
        return displaced(self.now.error, self.pivot, T_mount_palm @ self.now.T_palm_object)

    def _merged(self, T_mount_palm: Array, T_mount_object: Array, covariance: Array) -> Sights:
        """The sights with one more, merged into one from nearly the same palm if there is one."""
        sights = self.sights
        new = (T_mount_palm, T_mount_object, covariance, self.walk)
        if not len(sights):
            return sights.with_row(0, new)
        apart = se3.difference(sights.Ts_mount_palm, T_mount_palm[None])
        shift, turn = np.sqrt((apart * apart).reshape(-1, 2, 3).sum(axis=2)).T
        k = int(np.argmin(shift + TURN * turn))
        if len(sights) < MOST_SIGHTS and (shift[k] > NEAR_PALM[0] or turn[k] > NEAR_PALM[1]):
            return sights.with_row(len(sights), new)
        return sights.with_row(k, self._averaged(k, *new))

    def _averaged(
        self, k: int, T_mount_palm: Array, T_mount_object: Array, covariance: Array, walk: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Row k and a new one as one, from k's palm, each weighed by its information, against what was expected."""
        kept = self.sights
        T_kept = kept.Ts_mount_palm[k]
        expected = self.expected(T_kept)
        off_kept = se3.difference(kept.Ts_mount_object[k], expected)
        off_new = se3.difference(T_mount_object, self.expected(T_mount_palm))
        aged = kept.covariances[k] + along(T_kept, walk - kept.walks[k])
        both = np.linalg.inv(np.linalg.inv(aged) + np.linalg.inv(covariance))
        off = off_kept + both @ np.linalg.solve(covariance, off_new - off_kept)
        return T_kept, se3.moved(expected, off), (both + both.T) / 2, walk

    def _solved(self, sights: Sights) -> "Belief":
        """The prior and these sights, by Gauss-Newton from what is believed now."""
        Ts, seen = sights.Ts_mount_palm, sights.Ts_mount_object
        weights = np.linalg.inv(sights.covariances + along(Ts, self.walk - sights.walks))
        prior = self.prior.walked(self.walk)
        by_prior = np.linalg.inv(prior.covariance)
        joint = self.now
        for _ in range(STEPS):
            H, residual = self._sighting(joint, Ts, seen)
            weighed = H.swapaxes(1, 2) @ weights
            information = by_prior + (weighed @ H).sum(axis=0)
            gradient = (weighed @ residual[..., None]).sum(axis=0)[:, 0] - by_prior @ joint.less(prior)
            step = np.linalg.solve(information, gradient)
            joint = joint.moved(step)
            if step @ information @ step < SMALL:
                break
        covariance = np.linalg.inv(information)
        joint = replace(joint, covariance=(covariance + covariance.T) / 2)
        return replace(self, now=joint, sights=sights)

    def _sighting(self, joint: Joint, Ts_mount_palm: Array, Ts_mount_object: Array) -> tuple[Array, Array]:
        """Derivatives (k, 6, 12) of what vision sees, and what it saw less what it should have (k, 6)."""
        expected = displaced(joint.error, self.pivot, Ts_mount_palm @ joint.T_palm_object)
        turn = se3.rotation_exp(joint.error[3:]) @ Ts_mount_palm[:, :3, :3]
        H = np.zeros((len(Ts_mount_palm), 6, 12))
        H[:, :3, :3] = H[:, 3:, 3:6] = turn
        H[:, :, 6:] = EYE_6
        H[:, :3, 9:] = -se3.skew(expected[:, :3, 3] - self.pivot - joint.error[:3])
        return H, se3.difference(Ts_mount_object, expected)


def along(Ts_mount_palm: Array, walks: Array) -> Array:
    """(..., 6, 6) walks in the palm (..., 6) along the mount's axes."""
    R = Ts_mount_palm[..., :3, :3]
    out = np.zeros((*walks.shape, 6))
    out[..., :3, :3] = (R * walks[..., None, :3]) @ R.swapaxes(-1, -2)
    out[..., 3:, 3:] = (R * walks[..., None, 3:]) @ R.swapaxes(-1, -2)
    return out


def displaced(error: Array, pivot: Array, Ts_mount: Array) -> Array:
    """Where vision sees what is at (..., 4, 4) in its mount's frame, wrong by `error` (6,) about `pivot` (3,)."""
    E = se3.rotation_exp(error[3:])
    position = pivot + error[:3] + (Ts_mount[..., :3, 3] - pivot) @ E.T
    return se3.compose(E @ Ts_mount[..., :3, :3], position)


def turned(error: Array, step: Array) -> Array:
    """An error (6,) after a step (6,)."""
    turn = se3.rotation_log(se3.rotation_exp(step[3:]) @ se3.rotation_exp(error[3:]))
    return np.concatenate([error[:3] + step[:3], turn])


def positive(information: Array) -> Array:
    """The nearest positive semidefinite matrix, in metres and radians of a hand-sized object (0.1 m)."""
    scale = np.array([1.0] * 3 + [0.1] * 3)
    values, vectors = np.linalg.eigh(information / scale[:, None] / scale)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * scale[:, None] * scale)


def grown(information: Array, variance: Array) -> Array:
    """An information (6, 6), which may be singular, after a walk of `variance` (6,): (I⁻¹ + Q)⁻¹ without I⁻¹."""
    if not (variance > 0).any():
        return information
    # A walk of zero along an axis is one of next to nothing.
    inverse = np.diag(1 / np.maximum(variance, 1e-18))
    after = information - information @ np.linalg.solve(information + inverse, information)
    return np.asarray((after + after.T) / 2)
