"""The founding paper's pose correction, as published: equations 1 to 6 and Algorithm 1.

Contacts, not the object, are moved: `x = [q_w, q_x, q_y, q_z, t_x, t_y, t_z]` (eq. 1) carries the contact
points and normals, in the palm frame, onto the object where vision saw it; the inverse of the transform
found is then applied to the object.

The equations do not care about the unit of length, but their constants do: the damping of the quaternion
against the translation, the gradient's step and the finite difference all depend on it. So `correct` takes
and answers metres and works in centimetres inside, the unit in which the published constants were tuned.
What the paper leaves open, and what was chosen here, is said where it is chosen.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight.checks import MAX_DISTANCE, Array, brief, finite, positive, unit
from handsight.errors import InvalidInput
from handsight.se3 import compose, inverse

CM_PER_M = 100.0
MOST = 20_000
"""Points or steps."""

Cost = Callable[[Array], Array]
"""`G`: one x (7,) to (n,) residuals, or a stack (k, 7) to (k, n)."""


@dataclass(frozen=True, slots=True)
class PaperMethod:
    """A `PaperMethod` says which of the paper's four methods, and its constants."""

    optimizer: Literal["lm", "gd"] = "lm"
    """Levenberg-Marquardt (eq. 6) or gradient descent (eq. 5)."""
    normals: bool = True
    """Whether eq. 3 has its second term; without it only distances count."""
    w_n: float = 0.10
    """Weight of `1 - <û, n>` [m]."""
    cloud_size: int = 2000
    """Points to sample on the object's surface; read by whoever makes the cloud, not by `correct`."""
    epsilon: float = 0.02
    """Radius of a contact's region (eq. 2) before it grows [m]."""
    min_points: int = 200
    """Least number of cloud points in a region."""
    step: float = 1e-3
    """`h` of the forward difference (eq. 4), a fraction of ‖x‖."""
    damping: float = 1e-2
    """`λ` of Levenberg-Marquardt (eq. 6)."""
    learning_rate: float = 2e-3
    """`λ` of gradient descent (eq. 5), for residuals in centimetres."""
    max_iterations: int = 200
    """Steps after which the search gives up; the best iterate is still the answer."""
    tolerance: float = 1e-6
    """An iterate that lowers ‖G‖ by less than this is no improvement [m]."""
    patience: int = 10
    """Steps in a row without improvement that end the search."""

    def __post_init__(self) -> None:
        if self.optimizer not in ("lm", "gd"):
            raise InvalidInput(f"optimizer: expected 'lm' or 'gd', got {brief(self.optimizer)!r}")
        for name in ("w_n", "damping"):
            if not 0 <= finite(getattr(self, name), name, ()) <= MAX_DISTANCE:
                expected = f"expected a number from 0 to {MAX_DISTANCE:g}"
                raise InvalidInput(f"{name}: {expected}, got {brief(getattr(self, name))}")
        for name in ("epsilon", "step", "learning_rate", "tolerance"):
            if positive(getattr(self, name), name) > MAX_DISTANCE:
                expected = f"expected a number up to {MAX_DISTANCE:g}"
                raise InvalidInput(f"{name}: {expected}, got {brief(getattr(self, name))}")
        for name in ("cloud_size", "min_points", "max_iterations", "patience"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MOST:
                raise InvalidInput(f"{name}: expected a whole number from 1 to {MOST}, got {brief(value)}")


@dataclass(frozen=True, slots=True)
class PaperResult:
    """A `PaperResult` is the correction, and how the search for it ended."""

    T_new_old: Array
    """(4, 4), palm frame: `T_palm_object_new = T_new_old @ T_palm_object_old`."""
    iterations: int
    """Steps taken."""
    converged: bool
    """The search ended because it stopped improving, not at the limit of steps."""
    residuals: Array
    """G (eq. 3) at the answer, (n,) [m]; with normals it holds their weighted term too."""
    regions: list[NDArray[np.intp]]
    """Each contact's region (eq. 2): indices into the cloud, nearest first."""


@dataclass(frozen=True, slots=True)
class Matching:
    """A `Matching` is what eq. 3 compares: contacts, and each contact's region of the object. All lengths in one
    unit."""

    points: Array
    """`f`, (n, 3)."""
    surface_points: Array
    """`s` of each region, (n, K, 3); shorter regions are filled up with infinity."""
    normals: Array | None = None
    """`û`, (n, 3), unit: the object's outward normal as it was felt; None: distances alone."""
    surface_normals: Array | None = None
    """`n` of each `s`, (n, K, 3), unit; needed with `normals`."""
    w_n: float = 0.0
    """Weight of the normals' term, in the unit of length."""


def regions(points: Array, cloud: Array, epsilon: float, min_points: int) -> list[NDArray[np.intp]]:
    """Returns (eq. 2) for each contact the indices of cloud points within `epsilon`, nearest first.

    The paper sets the neighbourhood "dynamically so that a minimum number of points" is selected: a contact
    with fewer takes its `min_points` nearest, which is `epsilon` grown just so far; others keep theirs.
    """
    found = []
    for point in points:
        squared = ((cloud - point) ** 2).sum(axis=1)
        count = max(int((squared <= epsilon**2).sum()), min(min_points, len(cloud)))
        found.append(np.argsort(squared, kind="stable")[:count])
    return found


def residuals(x: Array, matching: Matching) -> Array:
    """Returns G(x) of eq. 3, (n,); a stack of x (k, 7) gives (k, n). The minimum is over the sum of both terms."""
    M = rotation(x[..., :4])
    moved = matching.points @ np.swapaxes(M, -1, -2) + x[..., None, 4:]
    gap = moved[..., None, :] - matching.surface_points
    cost = np.sqrt(np.einsum("...d,...d->...", gap, gap))
    if matching.normals is not None and matching.surface_normals is not None:
        turned = matching.normals @ np.swapaxes(M, -1, -2)
        cosine = (matching.surface_normals @ turned[..., None])[..., 0]
        cost = cost + matching.w_n * np.abs(1.0 - cosine)
    return np.asarray(cost.min(axis=-1), dtype=np.float64)


def rotation(q: Array) -> Array:
    """Returns the matrices of `v -> q v q*` for quaternions (..., 4), w first. Literal: they scale by |q|² too."""
    w, v = q[..., :1, None], q[..., 1:]
    outer = v[..., :, None] * v[..., None, :]
    cross = np.zeros_like(outer)
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    cross = cross - np.swapaxes(cross, -1, -2)
    squared = (v**2).sum(axis=-1)[..., None, None]
    return np.asarray((w**2 - squared) * np.eye(3) + 2 * outer + 2 * w * cross, dtype=np.float64)


def forward_difference_jacobian(G: Cost, x: Array, step: float) -> tuple[Array, Array]:
    """Returns (eq. 4) `G(x)` (n,) and its forward differences (n, 7) over `step · ‖x‖`, in one call of G."""
    h = step * float(np.linalg.norm(x))
    values = G(np.vstack([x, x + h * np.eye(len(x))]))
    return values[0], (values[1:] - values[0]).T / h


def gradient_step(x: Array, value: Array, jacobian: Array, learning_rate: float) -> Array:
    """Returns (eq. 5) x after one step against the gradient of ½‖G‖²."""
    return np.asarray(x - learning_rate * (jacobian.T @ value), dtype=np.float64)


def levenberg_marquardt_step(x: Array, value: Array, jacobian: Array, damping: float) -> Array:
    """Returns (eq. 6) x after one damped Gauss-Newton step; a parameter without influence stays where it is."""
    hessian = jacobian.T @ jacobian
    damped = hessian + damping * np.diag(np.diag(hessian))
    if not np.isfinite(damped).all():
        return np.full_like(x, np.nan)
    step = np.linalg.pinv(damped, hermitian=True) @ (jacobian.T @ value)
    return np.asarray(x - step, dtype=np.float64)


def normalised(x: Array) -> Array:
    """Returns `x` with a unit quaternion; without this the scale |q|² is one more, wrong, way to shrink the cost."""
    return np.concatenate([x[:4] / np.linalg.norm(x[:4]), x[4:]])


def minimise(G: Cost, method: PaperMethod) -> tuple[Array, Array, int, bool]:
    """Returns the best x met from the identity on, G there, steps taken, and whether the search came to rest.

    The paper names no stopping rule. Eq. 5 and 6 reject no step, so the cost may rise, and the best iterate
    is kept.
    """
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    best, best_value, lowest, mark, stalled = x, np.empty(0), np.inf, np.inf, 0
    for iteration in range(method.max_iterations + 1):
        value, jacobian = forward_difference_jacobian(G, x, method.step)
        cost = float(np.linalg.norm(value))
        if not np.isfinite(cost):
            return best, best_value, iteration, False
        if cost < lowest:
            best, best_value, lowest = x, value, cost
        if cost <= mark - CM_PER_M * method.tolerance:
            mark, stalled = cost, 0
        else:
            stalled += 1
        if stalled >= method.patience or cost == 0:
            return best, best_value, iteration, True
        if iteration < method.max_iterations:
            x = normalised(taken(x, value, jacobian, method))
    return best, best_value, method.max_iterations, False


def taken(x: Array, value: Array, jacobian: Array, method: PaperMethod) -> Array:
    """Returns x after the step of the chosen optimizer."""
    if method.optimizer == "gd":
        return gradient_step(x, value, jacobian, method.learning_rate)
    return levenberg_marquardt_step(x, value, jacobian, method.damping)


def correct(
    points_palm: Array,
    normals_palm: Array | None,
    cloud_palm: Array,
    cloud_normals_palm: Array,
    method: PaperMethod,
) -> PaperResult:
    """Returns (algorithm 1) the transform that brings the object, seen at `cloud_palm`, to the contacts.

    `points_palm` (n, 3) [m] and `normals_palm` (n, 3, the object's outward normals; None only where
    `method.normals` is False) are the contacts; `cloud_palm` (m, 3) [m] and `cloud_normals_palm` (m, 3) the
    object's surface at its first pose, all in the palm frame. Fewer than two contacts raise InvalidInput.
    """
    points = finite(points_palm, "points_palm", (None, 3))
    if len(points) < 2:
        raise InvalidInput(f"points_palm: the paper's method needs at least 2 fingers, got {len(points)}")
    cloud = finite(cloud_palm, "cloud_palm", (None, 3))
    if len(cloud) == 0:
        raise InvalidInput("cloud_palm: expected at least 1 point, got 0")
    found = regions(points, cloud, method.epsilon, method.min_points)
    normals = surface_normals = None
    if method.normals:
        if normals_palm is None:
            raise InvalidInput("normals_palm: this method compares normals, got None")
        normals = unit(normals_palm, "normals_palm", (len(points), 3))
        cloud_normals = unit(cloud_normals_palm, "cloud_normals_palm", (len(cloud), 3))
        surface_normals = padded(cloud_normals, found, 0.0)
    matching = Matching(
        points=CM_PER_M * points,
        surface_points=padded(CM_PER_M * cloud, found, np.inf),
        normals=normals,
        surface_normals=surface_normals,
        w_n=CM_PER_M * method.w_n,
    )
    x, value, iterations, converged = minimise(lambda stack: residuals(stack, matching), method)
    T_object_contacts = compose(rotation(x[:4]), x[4:] / CM_PER_M)
    return PaperResult(inverse(T_object_contacts), iterations, converged, value / CM_PER_M, found)


def padded(values: Array, found: list[NDArray[np.intp]], fill: float) -> Array:
    """Returns the rows of `values` of each region, (n, K, 3), shorter regions filled up."""
    rows = np.full((len(found), max(len(indices) for indices in found), 3), fill)
    for row, indices in zip(rows, found, strict=True):
        row[: len(indices)] = values[indices]
    return rows
