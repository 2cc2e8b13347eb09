"""What one would write in an afternoon: `scipy.optimize.least_squares` on a kd-tree's nearest points.

Six unknowns: the shift of the object's middle and a turn about it, from vision's pose. Rows: distance to the plane of
the nearest cloud point, the difference of normals, and the prior, each divided by its sigma. MINPACK ('lm').
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import handsight as hs
from benchmarks.workload import Problem, Solve
from handsight import se3


@dataclass
class ScipyLeastSquares:
    """Contacts, normals and prior; every contact's nearest point anew at each evaluation."""

    cloud_size: int = 5000
    analytic: bool = True
    """Derivatives by hand, the nearest point held; else SciPy's forward differences."""
    tolerance: float = 1e-3
    """Of cost, step and gradient; nearest points jump, so finer ones are never met."""
    method: str = "lm"
    """MINPACK's ('lm') or SciPy's own trust region ('trf')."""
    name = "scipy least_squares"
    uses_normals = True
    uses_prior = True

    def prepare(self, model: hs.ObjectModel) -> None:
        """The cloud's tree."""
        self._points, self._normals = model.sample(self.cloud_size)
        self._tree = cKDTree(self._points)
        self._center = model.center_object

    def ready(self, problem: Problem) -> Solve:
        """One least-squares solve from vision's pose."""
        fit = _Fit(self, problem)
        jacobian = fit.jacobian if self.analytic else "2-point"
        eps = self.tolerance
        options = {"ftol": eps, "xtol": eps, "gtol": eps, "method": self.method, "max_nfev": 200}

        def solve() -> np.ndarray:
            found = least_squares(fit.residuals, np.zeros(6), jac=jacobian, **options)
            return fit.pose(found.x)

        return solve

    def settings(self) -> list[dict[str, object]]:
        """Cloud sizes, and both ways to the derivative."""
        return [
            {"cloud_size": cloud, "analytic": analytic}
            for cloud in (1000, 2000, 5000, 10_000)
            for analytic in (True, False)
        ]

    def using(self, setting: dict[str, object]) -> "ScipyLeastSquares":
        """The same peer with other constants."""
        return ScipyLeastSquares(**setting)


class _Fit:
    """The residuals of one problem, and their derivative."""

    def __init__(self, peer: ScipyLeastSquares, problem: Problem) -> None:
        contacts, self._T = problem.contacts, problem.vision.T_palm_object
        variances = np.diagonal(contacts.covariance, axis1=1, axis2=2)
        self._sigma_point = np.sqrt(variances[:, 0])
        self._sigma_normal = np.sqrt(variances[:, 3:].sum(axis=1) / 2)[:, None]
        self._felt, self._peer = contacts, peer
        self._middle = se3.apply(self._T, peer._center[None])[0]
        # The prior is about the frame's origin: δp = δp_middle - δθ × lever.
        carry = np.eye(6)
        carry[:3, 3:] = se3.skew(self._middle - self._T[:3, 3])
        self._root = np.linalg.cholesky(np.linalg.inv(problem.vision.covariance)).T @ carry

    def pose(self, x: np.ndarray) -> np.ndarray:
        """`T_palm_object` of the unknowns."""
        turn = se3.rotation_exp(x[3:])
        arm = turn @ (self._T[:3, 3] - self._middle)
        return se3.compose(turn @ self._T[:3, :3], self._middle + x[:3] + arm)

    def _matched(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        T = self.pose(x)
        R = T[:3, :3]
        points = (self._felt.points_palm - T[:3, 3]) @ R
        found = self._peer._tree.query(points)[1]
        return R, points, self._felt.normals_palm @ R, self._peer._points[found], self._peer._normals[found]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """(4 n + 6,)."""
        _, points, felt, surface, normals = self._matched(x)
        distance = ((points - surface) * normals).sum(axis=1) / self._sigma_point
        return np.concatenate([distance, ((normals - felt) / self._sigma_normal).ravel(), self._root @ x])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(4 n + 6, 6)."""
        R, _, _, _, normals = self._matched(x)
        by_turn = left_jacobian(x[3:])
        normals_palm = normals @ R.T
        arm = self._felt.points_palm - self._middle - x[:3]
        rows = -np.hstack([normals_palm, np.cross(arm, normals_palm) @ by_turn]) / self._sigma_point[:, None]
        # Rᵀû by a turn δθ of the palm's axes: -Rᵀ(δθ × û).
        turned = -np.einsum("ji,njk->nik", R, se3.skew(self._felt.normals_palm)) @ by_turn
        bent = np.concatenate([np.zeros_like(turned), turned], axis=2) / self._sigma_normal[:, :, None]
        return np.vstack([rows, bent.reshape(-1, 6), self._root])


def left_jacobian(w: np.ndarray) -> np.ndarray:
    """(3, 3) with `exp(w + dw) ≈ exp(left_jacobian(w) dw) exp(w)`."""
    angle, S = np.linalg.norm(w), se3.skew(w)
    # x - sin x cancels below 1e-2: there the series is exact to rounding.
    cubic = 1 / 6 - angle**2 / 120 + angle**4 / 5040 if angle < 1e-2 else (angle - np.sin(angle)) / angle**3
    return np.eye(3) + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * S + cubic * (S @ S)
