"""The pose correction of the paper that handsight starts from (IROS 2013), as published: eq. 1 to 6 and Algorithm 1.

The contacts are moved, not the object: `x = [q_w, q_x, q_y, q_z, t_x, t_y, t_z]` (eq. 1) moves the contact points and
normals, in the palm frame, onto the object at vision's pose; the inverse of that transform then moves the object.

The constants depend on the unit of length: the damping of the quaternion against the translation, the gradient's step
and the finite difference. So `correct` takes and returns metres, and computes in centimetres, for which the published
constants were tuned. Where the paper leaves something open, a comment states the choice that was made here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight.checks import MAX_DISTANCE, Array, brief, finite, integer, positive, unit, within
from handsight.errors import InvalidInput
from handsight.se3 import compose, inverse

CM_PER_M = 100
MOST = 20_000
"""Largest number of points or of steps."""

Cost = Callable[[Array], Array]
"""`G` of eq. 3: one x (7,) to its residuals (n,), or a stack (k, 7) to (k, n)."""


@dataclass(frozen=True, slots=True)
class PaperMethod:
    """One of the paper's four methods, with its constants."""

    optimizer: Literal["lm", "gd"] = "lm"
    """Levenberg-Marquardt (eq. 6) or gradient descent (eq. 5)."""
    normals: bool = True
    """Whether eq. 3 has its second term, the angle between normals; without it only distances count."""
    w_n: float = 0.10
    """Weight of `1 - <û, n>` [m]."""
    cloud_size: int = 2000
    """Number of points that `correct_pose` samples on the object's surface; `correct` takes the cloud as it is."""
    epsilon: float = 0.02
    """Least radius of a contact's region (eq. 2) [m]."""
    min_points: int = 200
    """Least number of cloud points in a region."""
    step: float = 1e-3
    """`h` of the forward difference (eq. 4), a fraction of ‖x‖."""
    damping: float = 1e-2
    """`λ` of Levenberg-Marquardt (eq. 6)."""
    learning_rate: float = 2e-3
    """`λ` of gradient descent (eq. 5), for residuals in centimetres."""
    max_iterations: int = 200
    """Most steps of the search; after them the best iterate is the answer, with `converged` False."""
    tolerance: float = 1e-6
    """An iterate that lowers ‖G‖ by less than this is no improvement [m]."""
    patience: int = 10
    """Steps in a row without improvement that end the search."""

    def __post_init__(self) -> None:
        if self.optimizer not in ("lm", "gd"):
            raise InvalidInput(f"optimizer: expected 'lm' or 'gd', got {brief(self.optimizer)!r}")
        for name in ("w_n", "epsilon", "step", "damping", "learning_rate", "tolerance"):
            value = getattr(self, name)
            if name not in ("w_n", "damping") or value != 0:
                positive(value, name)
            within(finite(value, name, ()), name, MAX_DISTANCE, "numbers")
        for name in ("cloud_size", "min_points", "max_iterations", "patience"):
            integer(getattr(self, name), name, MOST, least=1)


@dataclass(frozen=True, slots=True)
class PaperResult:
    """A correction by the paper's method, and how its search ended."""

    T_new_old: Array
    """(4, 4), palm frame: `T_palm_object_new = T_new_old @ T_palm_object_old`."""
    iterations: int
    """Number of steps."""
    converged: bool
    """Whether the search ended because it stopped improving, and not at the limit of steps."""
    residuals: Array
    """(n,) G of eq. 3 at the answer [m], with the weighted term of the normals if they are used."""
    regions: list[NDArray[np.intp]]
    """Each contact's region (eq. 2): indices into the cloud, nearest first."""


@dataclass(frozen=True, slots=True)
class Matching:
    """What eq. 3 compares: contacts, and each one's region of the surface, in one unit of length."""

    points: Array
    """`f` of eq. 3, the contact points (n, 3)."""
    surface_points: Array
    """`s` of eq. 3, the points of each region (n, K, 3); shorter regions are filled up with infinity."""
    normals: Array | None = None
    """`û` of eq. 3, the measured outward unit normals (n, 3); None: only distances count."""
    surface_normals: Array | None = None
    """`n` of eq. 3, the unit normal of each `surface_points` (n, K, 3); needed with `normals`."""
    w_n: float = 0.0
    """Weight of the normals' term, in the unit of length."""


def regions(points: Array, cloud: Array, epsilon: float, min_points: int) -> list[NDArray[np.intp]]:
    """Returns each contact's region (eq. 2): the indices of the cloud's points within `epsilon`, nearest first.

    `points` (n, 3), `cloud` (m, 3). The paper sets the neighbourhood "dynamically so that a minimum number of points"
    is selected: here a contact with fewer points within `epsilon` has its `min_points` nearest ones as its region.
    """
    found = []
    for point in points:
        squared = ((cloud - point) ** 2).sum(axis=1)
        count = max(int((squared <= epsilon**2).sum()), min(min_points, len(cloud)))
        found.append(np.argsort(squared, kind="stable")[:count])
    return found


def residuals(x: Array, matching: Matching) -> Array:
    """Returns G(x) of eq. 3 (n,), or (k, n) for a stack of x (k, 7); the minimum is over the sum of both terms."""
    M = rotation(x[..., :4])
    moved = matching.points @ np.swapaxes(M, -1, -2) + x[..., None, 4:]
    gap = moved[..., None, :] - matching.surface_points
    cost = np.sqrt(np.einsum("...d,...d->...", gap, gap))
    if matching.normals is not None and matching.surface_normals is not None:
        turned = matching.normals @ np.swapaxes(M, -1, -2)
        cosine = (matching.surface_normals @ turned[..., None])[..., 0]
        cost = cost + matching.w_n * np.abs(1.0 - cosine)
    return np.asarray(cost.min(axis=-1))


def rotation(q: Array) -> Array:
    """Returns the matrices (..., 3, 3) of `v -> q v q*` for quaternions (..., 4), w first, which scale by |q|² too."""
    w = q[..., :1, None]
    v = q[..., 1:]
    outer = v[..., :, None] * v[..., None, :]
    cross = np.zeros_like(outer)
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    cross = cross - np.swapaxes(cross, -1, -2)
    squared = (v**2).sum(axis=-1)[..., None, None]
    return np.asarray((w**2 - squared) * np.eye(3) + 2 * outer + 2 * w * cross)


def forward_difference_jacobian(G: Cost, x: Array, step: float) -> tuple[Array, Array]:
    """Returns `G(x)` (n,) and its forward differences (n, 7) of step `step · ‖x‖` (eq. 4), in one call of G."""
    h = step * float(np.linalg.norm(x))
    values = G(np.vstack([x, x + h * np.eye(len(x))]))
    return values[0], (values[1:] - values[0]).T / h


def gradient_step(x: Array, value: Array, jacobian: Array, learning_rate: float) -> Array:
    """Returns x after one step against the gradient of ½‖G‖² (eq. 5)."""
    return np.asarray(x - learning_rate * (jacobian.T @ value))


def levenberg_marquardt_step(x: Array, value: Array, jacobian: Array, damping: float) -> Array:
    """Returns x after one damped Gauss-Newton step (eq. 6); a parameter without influence is not changed."""
    hessian = jacobian.T @ jacobian
    damped = hessian + damping * np.diag(np.diag(hessian))
    if not np.isfinite(damped).all():
        return np.full_like(x, np.nan)
    step = np.linalg.pinv(damped, hermitian=True) @ (jacobian.T @ value)
    return np.asarray(x - step)


def normalised(x: Array) -> Array:
    """Returns x (7,) with a unit quaternion; otherwise its scale |q|² could lower the cost too, which is wrong."""
    return np.concatenate([x[:4] / np.linalg.norm(x[:4]), x[4:]])


def minimise(G: Cost, method: PaperMethod) -> tuple[Array, Array, int, bool]:
    """Returns the best iterate x, G at it, the number of steps from the identity, and whether the search converged.

    The paper has no stopping rule; here the search stops after `patience` steps without improvement. Eq. 5 and 6 reject
    no step, so the cost may rise, and the best iterate is kept.
    """
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    best = x
    best_value = np.empty(0)
    lowest = np.inf
    mark = np.inf
    stalled = 0
    for iteration in range(method.max_iterations + 1):
        value, jacobian = forward_difference_jacobian(G, x, method.step)
        cost = float(np.linalg.norm(value))
        if not np.isfinite(cost):
            return best, best_value, iteration, False
        if cost < lowest:
            best, best_value, lowest = x, value, cost
        if cost <= mark - CM_PER_M * method.tolerance:
            mark = cost
            stalled = 0
        else:
            stalled += 1
        if stalled >= method.patience or cost == 0:
            return best, best_value, iteration, True
        if iteration < method.max_iterations:
            if method.optimizer == "gd":
                x = gradient_step(x, value, jacobian, method.learning_rate)
            else:
                x = levenberg_marquardt_step(x, value, jacobian, method.damping)
            x = normalised(x)
    return best, best_value, method.max_iterations, False


def correct(
    points_palm: Array,
    normals_palm: Array | None,
    cloud_palm: Array,
    cloud_normals_palm: Array,
    method: PaperMethod,
) -> PaperResult:
    """Returns the transform that moves the object from vision's pose to the contacts (Algorithm 1).

    All arguments are in the palm frame. `points_palm` (n, 3) [m] and `normals_palm` (n, 3) are the contacts and the
    object's outward normals; None: only distances count. `cloud_palm` (m, 3) [m] and `cloud_normals_palm` (m, 3) sample
    the object's surface at vision's pose. Raises InvalidInput for fewer than two contacts.
    """
    if len(points_palm) < 2:
        raise InvalidInput(
            f"points_palm: the paper's method needs at least 2 fingers, got {len(points_palm)}"
        )
    found = regions(points_palm, cloud_palm, method.epsilon, method.min_points)
    normals = surface_normals = None
    if method.normals and normals_palm is not None:
        normals = unit(normals_palm, "normals_palm", points_palm.shape)
        cloud_normals = unit(cloud_normals_palm, "cloud_normals_palm", cloud_palm.shape)
        surface_normals = padded(cloud_normals, found, 0.0)
    matching = Matching(
        points=CM_PER_M * points_palm,
        surface_points=padded(CM_PER_M * cloud_palm, found, np.inf),
        normals=normals,
        surface_normals=surface_normals,
        w_n=CM_PER_M * method.w_n,
    )
    x, value, iterations, converged = minimise(lambda stack: residuals(stack, matching), method)
    T_object_contacts = compose(rotation(x[:4]), x[4:] / CM_PER_M)
    return PaperResult(inverse(T_object_contacts), iterations, converged, value / CM_PER_M, found)


def padded(values: Array, found: list[NDArray[np.intp]], fill: float) -> Array:
    """Returns the rows of `values` (m, 3) of each region, (n, K, 3); shorter regions are filled up with `fill`."""
    rows = np.full((len(found), max(len(indices) for indices in found), 3), fill)
    for row, indices in zip(rows, found, strict=True):
        row[: len(indices)] = values[indices]
    return rows
