"""Errors of estimated poses against the true ones, up to the object's symmetries."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.tracking.replay import Step


@dataclass(frozen=True, slots=True, eq=False)
class TrackErrors:
    """Errors of poses in the palm, one row for each pose."""

    base: Array
    """(n,) error of the centre of the base in the table's plane, as the paper measures it [m]; in the palm's x and y
    where the palm's pose in the world is unknown."""
    middle: Array
    """(n,) error of the object's middle, in space [m]."""
    rotation: Array
    """(n,) angle between estimated and true rotation [rad]."""

    def __len__(self) -> int:
        return len(self.base)

    def summary(self) -> dict[str, float]:
        """Returns the means and the last values [mm, degrees], and the number of errors, which must be at least one."""
        return {
            "base_mean": 1000 * float(self.base.mean()),
            "base_last": 1000 * float(self.base[-1]),
            "middle_mean": 1000 * float(self.middle.mean()),
            "middle_last": 1000 * float(self.middle[-1]),
            "rotation_mean": float(np.rad2deg(self.rotation.mean())),
            "count": len(self),
        }


def pose_errors(model: ObjectModel, Ts: Array, Ts_true: Array, Ts_world_palm: Array) -> TrackErrors:
    """Returns the errors of n poses in the palm `Ts`, against `Ts_true`; all three stacks are (n, 4, 4)."""
    true = nearest(model.symmetries, Ts_true, Ts, model.radius)
    bases = base_center(model, Ts_world_palm @ Ts_true)[:, None]
    base = (se3.apply(Ts_world_palm @ Ts, bases) - se3.apply(Ts_world_palm @ true, bases))[:, 0, :2]
    middle = se3.apply(Ts, model.center_object[None]) - se3.apply(true, model.center_object[None])
    turn = se3.rotation_log(Ts[:, :3, :3] @ true[:, :3, :3].swapaxes(1, 2))
    return TrackErrors(*(np.linalg.norm(part, axis=1) for part in (base, middle[:, 0], turn)))


def base_center(model: ObjectModel, T_world_object: Array) -> Array:
    """Returns (..., 3) in the object [m] the middle of its bounding box's side that faces down at poses (..., 4, 4)."""
    low, high = model.bounds_object
    down = -T_world_object[..., 2, :3]
    axis = np.argmax(np.abs(down), axis=-1)[..., None]
    lowest = np.where(down > 0, high, low)
    center = np.broadcast_to((low + high) / 2, down.shape).copy()
    np.put_along_axis(center, axis, np.take_along_axis(lowest, axis, axis=-1), axis=-1)
    return center


class Truths:
    """The object's true poses in the palm, by their stamps."""

    def __init__(self, stamped: Iterable[tuple[float, Array]]) -> None:
        """`stamped`: (stamp [s], T_palm_object (4, 4)), in any order."""
        self._rows = sorted(stamped, key=lambda row: row[0])
        stamps = np.array([stamp for stamp, _ in self._rows])
        self._between = (stamps[:-1] + stamps[1:]) / 2

    def at(self, stamp: float) -> Array | None:
        """Returns the true pose (4, 4) nearest in time; None where none is within 50 ms."""
        if not self._rows:
            return None
        nearest_stamp, T = self._rows[np.searchsorted(self._between, stamp)]
        return T if abs(nearest_stamp - stamp) <= 0.05 else None


def track_errors(model: ObjectModel, steps: Iterable[Step], truths: Truths, *, vision: bool) -> TrackErrors:
    """Returns the errors of the estimates at the steps whose truth is known; with `vision`, those of vision's poses."""
    rows = []
    for step in steps:
        T = step.T_palm_object_vision if vision else step.estimate.T_palm_object
        true = None if T is None else truths.at(step.stamp)
        if true is not None:
            rows.append((T, true, np.eye(4) if step.T_world_palm is None else step.T_world_palm))
    if not rows:
        return TrackErrors(np.empty(0), np.empty(0), np.empty(0))
    return pose_errors(model, *(np.array(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True, slots=True)
class CorrectionErrors:
    """Errors of one corrected pose against the truth."""

    shift: float
    """Error of the object's origin [m]."""
    shift_observable: float
    """The part of `shift` along directions that the contacts make observable [m]."""
    turn: float
    """Angle between estimated and true rotation [rad]."""


def correction_errors(
    model: ObjectModel, T_palm_object: Array, T_true: Array, unobservable: Array
) -> CorrectionErrors:
    """Returns the errors of a pose (4, 4) against the true one (4, 4).

    `unobservable` (m, 6) are the unobservable directions, as `PoseEstimate` has them.
    """
    equivalent = nearest(model.symmetries, T_true, T_palm_object, model.radius)
    delta = se3.difference(T_palm_object, equivalent) * np.repeat([1.0, model.radius], 3)
    observable = delta - unobservable.T @ (unobservable @ delta)
    return CorrectionErrors(
        shift=float(np.linalg.norm(delta[:3])),
        shift_observable=float(np.linalg.norm(observable[:3])),
        turn=float(np.linalg.norm(delta[3:]) / model.radius),
    )
