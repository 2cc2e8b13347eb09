"""A correction propagated to now: the pose stays, its uncertainty grows with the process noise."""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate
from handsight.objects import ObjectModel

RENEW_AFTER = 0.02
"""How old the growth of a propagated covariance may be [s]: a micrometre or so."""


class Correction:
    """The answer of a correction, with what it was made from, asked for at later instants."""

    def __init__(
        self,
        estimate: PoseEstimate,
        contacts: Contacts,
        fingers: tuple[str, ...],
        stamp: float,
        process_noise: Array,
    ) -> None:
        """`contacts` were touched, by `fingers`, at `stamp` [s]; `process_noise` (6,): variance a second."""
        self.estimate, self.contacts, self.fingers, self.stamp = estimate, contacts, fingers, stamp
        self._process_noise = process_noise
        self._propagated, self._propagated_to = estimate, stamp
        self._variance: float | None = None

    def at(self, stamp: float) -> PoseEstimate:
        """The estimate propagated to `stamp` [s], give or take `RENEW_AFTER`."""
        if stamp - self._propagated_to > RENEW_AFTER and self._process_noise.any():
            last, variance = self.estimate, self._process_noise * (stamp - self.stamp)
            covariance = None if last.covariance is None else last.covariance + np.diag(variance)
            information = inflated_information(last.information, variance)
            self._propagated = last.with_gaussian(last.T_palm_object, covariance, information)
            self._propagated_to = stamp
        return self._propagated

    def sigma_of_point(self, stamp: float, model: ObjectModel, point_object: Array) -> float:
        """Largest standard deviation of the position of a point of the object (3,) [m], propagated to `stamp` [s].

        It is worked out once: ask for one point only.
        """
        if self._variance is None:
            self._variance = sigma_of_point(self.estimate, model, point_object) ** 2
        return float(np.sqrt(self._variance + self._process_noise[0] * (stamp - self.stamp)))


def inflated_information(information: Array, variance: Array) -> Array:
    """An information (6, 6), which may be singular, after process noise (6,): (I⁻¹ + Q)⁻¹ without I⁻¹."""
    # No noise along an axis is next to none.
    inverse = np.diag(1 / np.maximum(variance, 1e-18))
    after = information - information @ np.linalg.solve(information + inverse, information)
    return np.asarray((after + after.T) / 2)


def point_covariance(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> Array:
    """(3, 3) of where in the palm [m] a point fixed on the object (3,) is.

    What a declared symmetry leaves at zero in the information is no uncertainty.
    """
    scale = np.array([1.0, 1, 1, 1 / model.radius, 1 / model.radius, 1 / model.radius])
    values, vectors = np.linalg.eigh(estimate.information * scale[:, None] * scale)
    known = values > 1e-9 * values[-1]
    deviations = scale[:, None] * vectors[:, known] / np.sqrt(values[known])
    lever = estimate.T_palm_object[:3, :3] @ point_object
    point = deviations[:3] - se3.skew(lever) @ deviations[3:]
    return np.asarray(point @ point.T)


def sigma_of_point(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> float:
    """Largest standard deviation of where in the palm a point fixed on the object (3,) is [m]."""
    return float(np.sqrt(np.linalg.eigvalsh(point_covariance(estimate, model, point_object))[-1]))
