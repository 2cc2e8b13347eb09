"""The scale of a mesh that has none, from a depth image of the object or from touches of it.

A place P in the frame of the evidence, whose middle is c, is `x = Rᵀ(P - c) / s + q` in the mesh. Scales s are swept,
each with the poses that the first pose of an image or a blind correction finds at it. From these, R, q and log s are
refined together: depth points and touches lie on the surface, touches have its normal, and the line of sight at an
outline touches the surface (the least distance along it is 0).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.contact import Contacts
from handsight.correction import PosePrior
from handsight.correction.outliers import first_starts
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import FEW, Problem, poses_of
from handsight.correction.registration import spread
from handsight.correction.solve import solve
from handsight.correction.starts import usual
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.surface import diameter
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import first_pose, log_odds
from handsight.vision.object.locate import MAX_PLANE
from handsight.vision.object.region import observed_points, scene_of

STEP = 1.08
"""Between neighbouring scales of the sweep; first poses and blind corrections converge from within half of it."""
HIDDEN = 1.6
"""How many times as large the object may look as what is seen of it."""
UNTOUCHED = 6.0
"""How many times as large it may be as the touches are apart."""
CANDIDATES = 10
EACH = 3
"""Poses that are refined: of an image in all, of touches at each scale."""
POINTS = 300
RAYS = 80
INDEPENDENT = 20
"""Depth points and lines of sight that refine them, and for how many each of both kinds counts: neighbours share the
errors of the mesh and of the camera."""
ROBUST = 5.0
"""Residual from which on a depth point or a line of sight is not the object's [sigmas]."""
SHAPE = 0.01
"""Error of a generated mesh's surface, smooth over a fifth of the diameter [diameters]."""
OUTLINE = 0.7
"""Error of a line of sight at an outline, by itself, and again in common with all others [pixels]."""
SCALE_OF_DEPTH = 0.005
"""Share by which all depths of a camera may be off, by its baseline or its focal length."""
UNLIKELY = 4.5
"""Log likelihood by which a scale must be worse than the best one to be left out: three sigmas."""
MOST_SIGMA = 0.05
"""Share of the scale from which on the evidence counts as leaving it open."""
FLAT = 0.01
"""Mean square of the normals' second component, of that of the first, below which they are those of one plane."""
BRIEFLY = 8
STEPS = 40
"""Most steps of a refinement of each start, and of the best ones."""


@dataclass(frozen=True, slots=True)
class Scale:
    """By how much a mesh is to be scaled."""

    factor: float
    sigma: float
    """One standard deviation of the factor."""
    T: Array
    """(4, 4) pose of the scaled mesh in the frame of the evidence."""


class ScaleUnknown(InvalidInput):
    """The evidence does not tell the scale."""

    def __init__(self, message: str, candidates: tuple[float, ...] = ()) -> None:
        """`candidates`: factors that it leaves."""
        super().__init__(message)
        self.candidates = candidates


class _State(NamedTuple):
    """A pose and a scale, as at the top of this module."""

    R: Array
    q: Array
    scale: float

    def pose(self, center: Array) -> Array:
        """Returns the pose (4, 4) of the scaled mesh."""
        return se3.compose(self.R, center - self.scale * self.R @ self.q)

    def moved(self, step: Array) -> "_State":
        """Returns the state after a step (7,) of q, R and log s."""
        R = se3.rotation_exp(step[3:6]) @ self.R
        return _State(R, self.q + step[:3], float(self.scale * np.exp(step[6])))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What was measured of the object, in one frame."""

    points: Array
    """(n, 3) on the surface [m]."""
    normals: Array
    """(n, 3) unit, outward; 0 where there is none."""
    sigma_points: Array
    """(n,) [m]"""
    sigma_normals: Array
    """(n,) [rad]; infinite: a normal only tells the sides of the surface apart."""
    edges: Array
    """(m, 3) places on lines of sight from the origin, beside the object's outline, at its depth [m]."""
    sigma_edges: Array
    """(m,) [m]"""
    prior: PosePrior | None = None
    robust: float = np.inf
    """Residual from which on a row is not the object's [sigmas]."""

    @property
    def center(self) -> Array:
        """(3,) the points' mean [m]."""
        return np.asarray(self.points.mean(axis=0))

    def state(self, T: Array, scale: float) -> _State:
        """Returns the state at a pose (4, 4) of the scaled mesh."""
        return _State(T[:3, :3], (self.center - T[:3, 3]) @ T[:3, :3] / scale, scale)

    def rows(self, model: ObjectModel, state: _State) -> tuple[Array, Array]:
        """Returns the residuals (k,), unitless, and their derivatives (k, 7) by `_State.moved`'s step."""
        facing = np.isinf(self.sigma_normals)
        parts = [
            self._on_surface(model, state, self.points, self.sigma_points, self.normals * facing[:, None])
        ]
        if not facing.all():
            parts.append(self._along_normals(model, state))
        if len(self.edges) and model.closed:
            parts.append(self._on_surface(model, state, self._nearest(model, state), self.sigma_edges, None))
        if self.prior is not None:
            parts.append(self._at_prior(state, self.prior))
        return np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])

    def _on_surface(
        self, model: ObjectModel, state: _State, places: Array, sigmas: Array, normals: Array | None
    ) -> tuple[Array, Array]:
        v = (places - self.center) / state.scale
        field = model.evaluate(v @ state.R + state.q)
        g = field.gradient @ state.R.T
        per_sigma = state.scale / sigmas
        J = np.column_stack([field.gradient, np.cross(g, v), -(g * v).sum(axis=1)]) * per_sigma[:, None]
        r = field.distance * per_sigma
        if normals is not None:  # the other side of a wall
            wrong = (g * normals).sum(axis=1) < 0
            J[wrong] = 0.0
            r[wrong] = 2 * self.robust
        return r, J

    def _along_normals(self, model: ObjectModel, state: _State) -> tuple[Array, Array]:
        has = np.isfinite(self.sigma_normals) & self.normals.any(axis=1)
        v = (self.points[has] - self.center) / state.scale
        field = model.evaluate(v @ state.R + state.q)
        length = np.linalg.norm(field.gradient, axis=1)[:, None] + 1e-12
        g = field.gradient / length
        across = np.eye(3) - g[:, :, None] * g[:, None]
        by_place = state.R @ across @ field.hessian / length[:, :, None]
        n = g @ state.R.T
        by_frame = by_place @ state.R.T
        skew_v = np.array([se3.skew(each) for each in v])
        skew_n = np.array([se3.skew(each) for each in n])
        by_scale = -by_frame @ v[:, :, None]
        J = np.concatenate([by_place, by_frame @ skew_v - skew_n, by_scale], axis=2)
        sigmas = self.sigma_normals[has][:, None]
        return ((n - self.normals[has]) / sigmas).ravel(), (J / sigmas[:, :, None]).reshape(-1, 7)

    def _nearest(self, model: ObjectModel, state: _State) -> Array:
        """Returns the places (m, 3) on the lines of sight, near the outline's depth, that are nearest to the mesh."""
        places = self.edges
        reach = 0.15 * model.diameter * state.scale
        way = places / np.linalg.norm(places, axis=1)[:, None]
        for _ in range(3):  # to a five hundredth of the diameter
            tried = places[:, None] + reach * np.linspace(-1, 1, 9)[:, None] * way[:, None]
            inside = (tried - self.center) / state.scale @ state.R + state.q
            distance = model.evaluate(inside.reshape(-1, 3)).distance.reshape(len(places), -1)
            places = tried[np.arange(len(places)), distance.argmin(axis=1)]
            reach /= 4
        return places

    def _at_prior(self, state: _State, prior: PosePrior) -> tuple[Array, Array]:
        whiten = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        steps = 1e-6 * np.vstack([np.zeros(7), np.eye(7)])
        poses = np.array([state.moved(step).pose(self.center) for step in steps])
        off = se3.difference(poses, np.broadcast_to(prior.T_palm_object, poses.shape)) @ whiten.T
        return off[0], (off[1:] - off[0]).T / 1e-6


class _Fit(NamedTuple):
    """Where a refinement ended."""

    state: _State
    cost: float
    """Minus the log likelihood, up to a constant."""
    estimator: Array
    """(7, k) by which errors of the residuals move the step."""
    information: Array
    """(7, 7) of the rows, as far as they are the object's."""


def _refined(model: ObjectModel, evidence: _Evidence, state: _State, steps: int) -> _Fit:
    """Returns the minimum near a state, by Levenberg and Marquardt's steps."""
    unknown = np.diag(np.r_[np.repeat(model.diameter, 3), 1.0, 1.0, 1.0, 1.0] ** -2.0)
    share = _shares(model, evidence)
    damping = 1e-3

    def evaluated(at: _State) -> tuple[float, Array, Array, Array]:
        r, J = evidence.rows(model, at)
        if not np.isfinite(evidence.robust):
            return float(r @ r) / 2, r, J, np.ones(len(r))
        rest = np.maximum(1 - (r / evidence.robust) ** 2, 0.0)  # Tukey's biweight
        cost = evidence.robust**2 / 6 * (1 - rest**3)
        return float(share @ cost), r, J, share * rest**2

    cost, r, J, weight = evaluated(state)
    for _ in range(steps):
        information = (J.T * weight) @ J
        damped = information + unknown + damping * np.diag(np.diag(information))
        step = -np.linalg.solve(damped, (J.T * weight) @ r)
        moved = state.moved(step.clip(-0.2, 0.2))
        tried = evaluated(moved)
        if tried[0] > cost:
            damping *= 5
            continue
        done = cost - tried[0] < 1e-6 * cost
        state = moved
        cost, r, J, weight = tried
        damping /= 3
        if done:
            break
    information = (J.T * weight) @ J
    estimator = _inverse(information + unknown) @ (J.T * weight)
    return _Fit(state, cost, estimator, information + unknown)


def _shares(model: ObjectModel, evidence: _Evidence) -> Array:
    """Returns for how much each row of an image counts (k,)."""
    n = len(evidence.points)
    m = len(evidence.edges) if model.closed else 0
    shares = np.ones(n + m)
    shares[:n] = min(INDEPENDENT / n, 1)
    shares[n:] = min(INDEPENDENT / max(m, 1), 1)
    return shares


def scale_by_depth(
    model: ObjectModel, depth: Depth, camera: Camera, mask: Mask, *, noise: DepthNoise = STRUCTURED_LIGHT
) -> Scale:
    """Returns by how much a mesh is to be scaled to be the object in a mask (h, w) of a depth image (h, w) [m].

    The mesh should be about as large as objects are. Sigma counts the camera's noise and constant errors, 0.5 % for the
    scale of its depths, and 1 % of the diameter for the shape. Raises ScaleUnknown where no scale
    fits, where several do, or where sigma would be more than 5 %.
    """
    first = scene_of(camera, depth, wanted=mask)
    of_pixel = float(first.depth[first.labels >= 0].mean() if len(first.sizes) else 1.0) / camera.matrix[0, 0]
    pixels = observed_points(first, of_pixel, 20 * POINTS)
    if len(pixels) < 4 * INDEPENDENT:
        raise ScaleUnknown(f"expected depth in the mask, got {len(pixels)} points there")
    extent = _extent(pixels["point"])
    low = 0.9 * extent / model.diameter
    high = 1.1 * HIDDEN * extent / _narrowest(model)
    scene = scene_of(camera, depth, wanted=mask, extent=MAX_PLANE * high * model.diameter)
    if not len(scene.sizes):
        raise ScaleUnknown(f"expected the object in the mask, got none: {scene.reason}")
    rows = observed_points(scene, extent / 40, POINTS)
    z = rows["point"][:, 2]
    shape = SHAPE * extent
    edges = _edges(camera, scene.depth, scene.labels >= 0, 0.05 * extent)
    of_pixel = OUTLINE * edges[:, 2] / camera.matrix[0, 0]
    evidence = _Evidence(
        points=rows["point"].astype(float),
        normals=rows["normal"].astype(float),
        sigma_points=np.hypot(np.hypot(noise.sigma(z), noise.bias(z)), shape),
        sigma_normals=np.full(len(rows), np.inf),
        edges=edges,
        sigma_edges=np.hypot(np.sqrt(2) * of_pixel, shape),
        robust=ROBUST,
    )
    starts = list[tuple[float, _State]]()
    for scale in _sweep(low, high):
        # The same image, and its camera, of a scene that is so much smaller.
        smaller = replace(scene, depth=scene.depth / np.float32(scale))
        found = first_pose(model, smaller, noise=_scaled(noise, scale))
        odds = log_odds(found.candidates)
        for k in np.argsort(-odds)[:3]:
            T = found.Ts_camera_object[k] * np.array([[1, 1, 1, scale]] * 3 + [[1, 1, 1, 1]])
            starts.append((float(-odds[k]), evidence.state(T, scale)))
    starts.sort(key=lambda each: each[0])
    fits = _fits(model, evidence, [state for _, state in starts[:CANDIDATES]])
    covariance = _image_covariance(camera, noise, evidence, model, fits[0])
    spread = fits[0].estimator @ covariance @ fits[0].estimator.T
    left = 1 / _inverse(fits[0].information)[6, 6]  # of an open scale as little as was assumed of it
    share = np.sqrt(spread[6, 6] + SCALE_OF_DEPTH**2 + (1.0 if left < 4 else 0.0))
    return _judged(evidence, fits, float(share), (low, high))


def scale_by_touch(model: ObjectModel, contacts: Contacts, *, vision: PosePrior | None = None) -> Scale:
    """Returns by how much a mesh is to be scaled to be the object that was touched at three places or more.

    vision: roughly the pose of the scaled mesh in the frame of the contacts; None: unknown. Raises ScaleUnknown as
    `scale_by_depth`.
    """
    if len(contacts) < 3:
        raise ScaleUnknown(f"expected at least three touches, got {len(contacts)}")
    points = contacts.points_palm
    extent = diameter(points)
    blocks = np.einsum("nii->ni", contacts.covariance)
    shape = SHAPE * extent
    normal = np.sqrt(blocks[:, 3:].sum(axis=1) / 2)
    evidence = _Evidence(
        points=points,
        normals=contacts.normals_palm,
        sigma_points=np.hypot(np.sqrt(blocks[:, :3].mean(axis=1)), shape),
        sigma_normals=np.where(contacts.has_normal, np.hypot(normal, model.sigma_normal), 1e3),
        edges=np.empty((0, 3)),
        sigma_edges=np.empty(0),
        prior=vision,
    )
    low = 0.9 * extent / model.diameter
    high = UNTOUCHED * extent / model.diameter
    few = contacts.with_own_errors()
    few = few if len(few) <= FEW else few.select(spread(few, FEW))
    wider = few.covariance.copy()
    wider[:, :3, :3] += ((STEP - 1) / 2 * extent) ** 2 * np.eye(3)
    units = np.repeat([1.0, 0.0], 3)
    starts = list[_State]()
    middle = evidence.center
    for scale in _sweep(low, high):
        by = scale ** -(units[:, None] + units)
        smaller = Contacts((few.points_palm - middle) / scale, _given(few), covariance=wider * by)
        prior = None
        if vision is not None:
            T = vision.T_palm_object.copy()
            T[:3, 3] = (T[:3, 3] - middle) / scale
            prior = PosePrior(T, vision.covariance * by)
        problem = Problem(model, smaller, prior, NO_OUTSIDE)
        begin = first_starts(problem, usual(problem))
        minima = solve(problem, begin[None], problem.everyone).minima
        _, distinct = np.unique(minima["cost"].round(2), return_index=True)  # others are symmetric
        for T in poses_of(minima[distinct[:EACH]]):
            T[:3, 3] = scale * T[:3, 3] + middle
            starts.append(evidence.state(T, scale))
    fits = _fits(model, evidence, starts)
    rows = len(fits[0].estimator[0])
    covariance = _inverse(fits[0].information)
    if 2 * fits[0].cost > rows + 4 * np.sqrt(2 * rows):
        came = f"residuals of {np.sqrt(2 * fits[0].cost / rows):.1f} sigmas at the best one"
        raise ScaleUnknown(f"expected one at which the touches fit the mesh, got {came}")
    return _judged(evidence, fits, float(np.sqrt(covariance[6, 6])), (low, high))


def _given(contacts: Contacts) -> list[Array | None]:
    pairs = zip(contacts.normals_palm, contacts.has_normal, strict=True)
    return [normal if has else None for normal, has in pairs]


def _sweep(low: float, high: float) -> Iterator[float]:
    """Yields scales from the least to the largest, at equal ratios."""
    count = int(np.ceil(np.log(high / low) / np.log(STEP))) + 1
    yield from np.geomspace(low, high, max(count, 2)).tolist()


def _fits(model: ObjectModel, evidence: _Evidence, starts: list[_State]) -> list[_Fit]:
    """Returns where the starts lead, the best first; raises InvalidInput where there are none."""
    if not starts:
        raise ScaleUnknown("expected the object at some scale, got nothing that looks like it")
    fits = [_refined(model, evidence, state, BRIEFLY) for state in starts]
    fits.sort(key=lambda fit: fit.cost)
    best = [_refined(model, evidence, fit.state, STEPS) for fit in fits[:CANDIDATES]]
    return sorted(best + fits[CANDIDATES:], key=lambda fit: fit.cost)


def _inverse(information: Array) -> Array:
    """Returns the inverse of an information (7, 7), whose units differ by orders of magnitude."""
    unit = 1 / np.sqrt(np.diag(information))
    units = np.outer(unit, unit)
    return np.asarray(np.linalg.inv(information * units) * units)


def _judged(evidence: _Evidence, fits: list[_Fit], share: float, bounds: tuple[float, float]) -> Scale:
    """Returns the best scale; raises ScaleUnknown where it is open, or another one fits as well."""
    best = fits[0].state
    share = float(np.hypot(share, _spread(fits)))
    near = np.log(1 + max(3 * share, STEP / 2 - 0.5))
    others = [fit.state.scale for fit in fits if fit.cost - fits[0].cost < UNLIKELY]
    rivals = [other for other in others if abs(np.log(other / best.scale)) > near]
    if not share <= MOST_SIGMA:
        spread = np.linalg.eigvalsh(evidence.normals.T @ evidence.normals)
        plane = ", as only a plane is seen" if spread[1] < FLAT * spread[2] else ""
        raise ScaleUnknown(
            f"expected evidence that fixes the scale, got one that leaves it open by {100 * share:.0f} %{plane}",
            (best.scale,),
        )
    if rivals:
        raise ScaleUnknown("expected evidence that fits one scale, got several", (best.scale, rivals[0]))
    if not bounds[0] / STEP < best.scale < bounds[1] * STEP:
        came = "one at the end of those that were tried"
        raise ScaleUnknown(f"expected a scale at which the object is about as large as seen, got {came}", ())
    return Scale(best.scale, best.scale * share, best.pose(evidence.center))


def _spread(fits: list[_Fit]) -> float:
    """Returns the standard deviation of log s over the minima near the best one, by their likelihoods."""
    weights = dict[float, float]()
    for fit in fits:
        off = round(
            float(np.log(fit.state.scale / fits[0].state.scale)), 2
        )  # one of those that are symmetric
        if abs(off) < STEP - 1:
            weights.setdefault(off, float(np.exp(fits[0].cost - fit.cost)))
    square = sum(weight * off**2 for off, weight in weights.items())
    return float(np.sqrt(square / sum(weights.values())))


def _image_covariance(
    camera: Camera, noise: DepthNoise, evidence: _Evidence, model: ObjectModel, fit: _Fit
) -> Array:
    """Returns the covariance (k, k) of the residuals of an image, with the errors that they share."""
    P = evidence.points
    z = P[:, 2]
    apart2 = ((P[:, None] - P) ** 2).sum(axis=2)
    pixel = z.mean() / camera.matrix[0, 0]
    near = np.exp(-apart2 / (noise.correlation * pixel) ** 2)
    smooth = np.exp(-apart2 / (noise.smooth_length * pixel) ** 2)
    along = (evidence.normals * (P / z[:, None])).sum(axis=1)  # by which an error of depth is one of distance
    variance = np.median(noise.sigma(z)) ** 2
    of_depth = variance * (noise.correlated * near + (1 - noise.correlated) * np.eye(len(P)))
    of_depth += (noise.smooth * np.median(z) ** 2) ** 2 * smooth + noise.offset**2
    size = model.diameter * fit.state.scale
    points = of_depth * along[:, None] * along + (SHAPE * size) ** 2 * np.exp(-apart2 / (0.2 * size) ** 2)
    points /= evidence.sigma_points[:, None] * evidence.sigma_points
    total = np.zeros(2 * [fit.estimator.shape[1]])
    n = len(P)
    total[:n, :n] = points
    if len(total) > n:
        apart2 = ((evidence.edges[:, None] - evidence.edges) ** 2).sum(axis=2)
        of_pixel = OUTLINE * evidence.edges[:, 2] / camera.matrix[0, 0]
        shape = (SHAPE * size) ** 2 * np.exp(-apart2 / (0.2 * size) ** 2)
        edges = of_pixel[:, None] * of_pixel * (1 + np.eye(len(of_pixel))) + shape
        total[n:, n:] = edges / (evidence.sigma_edges[:, None] * evidence.sigma_edges)
    return total


def _edges(camera: Camera, depth: Depth, inside: Mask, gap: float) -> Array:
    """Returns places (m, 3) [m] half a pixel beside pixels of the object where what is behind is farther by a gap."""
    own = np.pad(np.where(inside, depth, 0), 3)
    rows = np.arange(own.shape[0])[:, None] + 0 * own
    columns = np.arange(own.shape[1]) + 0 * own
    found = list[Array]()
    for way in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        open_ = own > 0
        for step in (1, 2, 3):  # shadows have no depth
            other = np.roll(np.pad(depth, 3), (-step * way[0], -step * way[1]), axis=(0, 1))
            hit = open_ & (other > own + gap)
            v = rows[hit] - 3 + way[0] / 2
            u = columns[hit] - 3 + way[1] / 2
            found.append(np.column_stack([u, v, own[hit]]))
            open_ &= ~(other > 0)
    every = np.concatenate(found)
    every = every[np.random.default_rng(0).permutation(len(every))[:RAYS]]
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    slopes = (every[:, :2] - camera.matrix[:2, 2]) / [fx, fy]
    return np.column_stack([slopes, np.ones(len(every))]) * every[:, 2:]


def _scaled(noise: DepthNoise, scale: float) -> DepthNoise:
    """Returns the errors of a camera whose depths are divided by a scale."""
    a, b, c = noise.axial
    growing = {name: getattr(noise, name) * scale for name in ("step", "smooth")}
    return replace(noise, axial=(a / scale, b, c * scale), offset=noise.offset / scale, **growing)


def _extent(points: Array) -> float:
    """Returns the largest distance between points (n, 3) [m], but for a few that lie apart."""
    some = points[:400]
    return float(np.quantile(np.linalg.norm(some[:, None] - some, axis=2).max(axis=1), 0.9))


def _narrowest(model: ObjectModel) -> float:
    """Returns how wide the mesh's silhouette is at least, in its widest direction, from any side [m]."""
    ways = se3.directions(60)
    points = model.points_object
    return min(diameter(points - np.outer(points @ way, way)) for way in ways)
