"""The scale of a mesh that has none, from a depth image of the object or from touches of it.

A place P in the frame of the evidence is `x = Rᵀ(P - p) / s` in the mesh. Scales s are swept, each with the poses R, p
that the first pose of an image or a blind correction finds at it. From these, R, p and log s are refined
together: depth points and touches lie on the surface, touches have its normal, and the line of sight at an
outline touches the surface (the least distance along it is 0).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are used

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.contact import Contacts
from handsight.correction import PosePrior, correct_pose
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
"""Poses that are refined: of all, and at each scale."""
POINTS = 300
RAYS = 80
INDEPENDENT = 20
"""Depth points and lines of sight that refine them, and for how many each of both kinds counts: neighbours share the
errors of the mesh and of the camera."""
ROBUST = 5.0
"""Residual from which on a depth point or a line of sight is not the object's [sigmas]."""
ALL = 1e3
"""The same of touches, of which each is the object's."""
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
    """A scale, and the pose of the scaled mesh."""

    T: Array
    scale: float

    def in_mesh(self, places: Array) -> Array:
        """Returns places (n, 3) in the mesh."""
        return se3.apply(se3.inverse(self.T), places) / self.scale


class _Fit(NamedTuple):
    """Where a refinement ended."""

    state: _State
    cost: float
    """Minus the log likelihood, up to a constant."""
    information: Array
    """(7, 7) of a step of the state."""


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What was measured of the object, in one frame."""

    model: ObjectModel
    points: Array
    """(n, 3) on the surface [m]."""
    normals: Array
    """(n, 3) unit, outward; 0 where there is none."""
    sigma_points: Array
    """(n,) [m]"""
    sigma_normals: Array | None = None
    """(n,) [rad]; None: a normal only tells the sides of the surface apart."""
    edges: tuple[Array, Array] | None = None
    """(m, 3) places on lines of sight from the origin, beside the object's outline, at its depth [m], and (m,) their
    sigmas [m]; None where none counts."""
    prior: PosePrior | None = None

    @property
    def center(self) -> Array:
        """(3,) the points' mean [m]."""
        return np.asarray(self.points.mean(axis=0))

    def moved(self, state: _State, step: Array) -> _State:
        """Returns the state after a step (7,): a shift, and a turn and a growth (log) about the center."""
        growth = np.exp(step[6])
        turn = se3.rotation_exp(step[3:6])
        arm = growth * turn @ (state.T[:3, 3] - self.center)
        T = se3.compose(turn @ state.T[:3, :3], self.center + arm + step[:3])
        return _State(T, float(state.scale * growth))

    def residuals(self, state: _State) -> Array:
        """Returns the residuals (k,), unitless."""
        field = self.model.evaluate(state.in_mesh(self.points))
        off = field.distance * state.scale / self.sigma_points
        normals = field.gradient @ state.T[:3, :3].T
        if self.sigma_normals is None:
            other_side = (normals * self.normals).sum(axis=1) < 0  # of a wall
            off[other_side] = 2 * ROBUST
            parts = [off]
        else:
            normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
            turned = (normals - self.normals) / self.sigma_normals[:, None]
            parts = [off, turned.ravel()]
        if self.edges is not None:
            places, sigmas = self.edges
            parts.append(self._beside(places, state) * state.scale / sigmas)
        if self.prior is not None:
            whiten = np.linalg.inv(np.linalg.cholesky(self.prior.covariance))
            parts.append(whiten @ se3.difference(state.T, self.prior.T_palm_object))
        return np.concatenate(parts)

    def _beside(self, places: Array, state: _State) -> Array:
        """Returns the least distances (m,) of the mesh from lines of sight, near the outline's depth."""
        reach = 0.15 * self.model.diameter * state.scale
        way = places / np.linalg.norm(places, axis=1)[:, None]
        for _ in range(4):  # to a two thousandth of the diameter
            tried = places[:, None] + reach * np.linspace(-1, 1, 9)[:, None] * way[:, None]
            inside = state.in_mesh(tried.reshape(-1, 3))
            distance = self.model.evaluate(inside).distance.reshape(len(places), -1)
            places = tried[np.arange(len(places)), distance.argmin(axis=1)]
            reach /= 4
        return np.asarray(distance.min(axis=1))

    def loss(self, squared: Array) -> Array:
        """Returns Tukey's biweight (3, k) of squared residuals (k,), with its two derivatives."""
        share = np.ones(len(squared))
        bound = ALL
        if self.sigma_normals is None:
            n = len(self.points)
            share[:n] = INDEPENDENT / n
            share[n:] = INDEPENDENT / max(len(squared) - n, INDEPENDENT)
            bound = ROBUST
        rest = np.maximum(1 - squared / bound**2, 0.0)
        return np.stack([bound**2 / 3 * (1 - rest**3), rest**2, -2 / bound**2 * rest]) * share

    def refined(self, start: _State, steps: int) -> _Fit:
        """Returns the minimum near a state."""
        unit = np.append(np.full(3, self.model.diameter), np.ones(4))
        found = scipy.optimize.least_squares(
            lambda step: self.residuals(self.moved(start, step)),
            np.zeros(7),
            loss=self.loss,
            x_scale=unit,
            max_nfev=steps,
        )
        information = found.jac.T @ found.jac + np.diag(unit**-2.0)
        return _Fit(self.moved(start, found.x), found.cost, information)

    def fits(self, starts: list[_State]) -> list[_Fit]:
        """Returns where the starts lead, the best first; raises InvalidInput where there are none."""
        if not starts:
            raise ScaleUnknown("expected the object at some scale, got nothing that looks like it")
        fits = sorted([self.refined(state, BRIEFLY) for state in starts], key=lambda fit: fit.cost)
        best = [self.refined(fit.state, STEPS) for fit in fits[:CANDIDATES]]
        return sorted(best + fits[CANDIDATES:], key=lambda fit: fit.cost)


def scale_by_depth(
    model: ObjectModel, depth: Depth, camera: Camera, mask: Mask, *, noise: DepthNoise = STRUCTURED_LIGHT
) -> Scale:
    """Returns by how much a mesh is to be scaled to be the object in a mask (h, w) of a depth image (h, w) [m].

    The mesh should be about as large as objects are. Sigma counts the camera's noise and constant errors, 0.5 % for the
    scale of its depths, and 1 % of the diameter for the shape. Raises ScaleUnknown where no scale
    fits, where several do, or where sigma would be more than 5 %.
    """
    focal = camera.matrix[0, 0]
    first = scene_of(camera, depth, wanted=mask)
    of_pixel = float(first.depth[first.labels >= 0].mean() if len(first.sizes) else 1.0) / focal
    pixels = observed_points(first, of_pixel, 20 * POINTS)
    if len(pixels) < 4 * INDEPENDENT:
        raise ScaleUnknown(f"expected depth in the mask, got {len(pixels)} points there")
    extent = _extent(pixels["point"])
    bounds = 0.9 * extent / model.diameter, 1.1 * HIDDEN * extent / _narrowest(model)
    scene = scene_of(camera, depth, wanted=mask, extent=MAX_PLANE * bounds[1] * model.diameter)
    if not len(scene.sizes):
        raise ScaleUnknown(f"expected the object in the mask, got none: {scene.reason}")
    rows = observed_points(scene, extent / 40, POINTS)
    z = rows["point"][:, 2]
    shape = SHAPE * extent
    edges = _edges(camera, scene.depth, scene.labels >= 0, 0.05 * extent)
    sigma_edges = np.hypot(np.sqrt(2) * OUTLINE * edges[:, 2] / focal, shape)
    evidence = _Evidence(
        model,
        points=rows["point"].astype(float),
        normals=rows["normal"].astype(float),
        sigma_points=np.hypot(np.hypot(noise.sigma(z), noise.bias(z)), shape),
        edges=(edges, sigma_edges) if model.closed and len(edges) else None,
    )
    starts = list[tuple[float, _State]]()
    for scale in _sweep(*bounds):
        # The same image, and its camera, of a scene that is so much smaller.
        smaller = replace(scene, depth=scene.depth / np.float32(scale))
        found = first_pose(model, smaller, noise=_scaled(noise, scale))
        odds = log_odds(found.candidates)
        for k in np.argsort(-odds)[:EACH]:
            T = found.Ts_camera_object[k].copy()
            T[:3, 3] *= scale
            starts.append((float(odds[k]), _State(T, scale)))
    starts.sort(key=lambda each: -each[0])
    fits = evidence.fits([state for _, state in starts[:CANDIDATES]])
    variance = np.linalg.inv(fits[0].information)[6, 6]
    is_open = variance > 0.25  # as little as was assumed of it
    in_common = 2 * OUTLINE * of_pixel / extent  # by opposite outlines
    share = np.sqrt(variance + SCALE_OF_DEPTH**2 + in_common**2 + is_open)
    return _judged(evidence, fits, float(share), bounds)


def scale_by_touch(model: ObjectModel, contacts: Contacts, *, vision: PosePrior | None = None) -> Scale:
    """Returns by how much a mesh is to be scaled to be the object that was touched at three places or more.

    vision: roughly the pose of the scaled mesh in the frame of the contacts; None: unknown. Raises ScaleUnknown as
    `scale_by_depth`.
    """
    if len(contacts) < 3:
        raise ScaleUnknown(f"expected at least three touches, got {len(contacts)}")
    contacts = contacts.with_own_errors()
    points = contacts.points_palm
    extent = diameter(points)
    variances = np.einsum("nii->ni", contacts.covariance)
    normal = np.sqrt(variances[:, 3:].sum(axis=1) / 2)
    evidence = _Evidence(
        model,
        points=points,
        normals=contacts.normals_palm,
        sigma_points=np.hypot(np.sqrt(variances[:, :3].mean(axis=1)), SHAPE * extent),
        sigma_normals=np.where(contacts.has_normal, np.hypot(normal, model.sigma_normal), 1e3),
        prior=vision,
    )
    bounds = 0.9 * extent / model.diameter, UNTOUCHED * extent / model.diameter
    wider = contacts.covariance.copy()
    wider[:, :3, :3] += ((STEP - 1) / 2 * extent) ** 2 * np.eye(3)
    pairs = zip(contacts.normals_palm, contacts.has_normal, strict=True)
    normals = [normal if has else None for normal, has in pairs]
    starts = list[_State]()
    for scale in _sweep(*bounds):
        unit = np.repeat([scale, 1.0], 3)
        units = np.outer(unit, unit)
        smaller = Contacts((points - evidence.center) / scale, normals, covariance=wider / units)
        prior = None
        if vision is not None:
            T = vision.T_palm_object.copy()
            T[:3, 3] = (T[:3, 3] - evidence.center) / scale
            prior = PosePrior(T, vision.covariance / units)
        for mode in correct_pose(model, smaller, vision=prior).hypotheses[:EACH]:
            T = mode.T_palm_object.copy()
            T[:3, 3] = scale * T[:3, 3] + evidence.center
            starts.append(_State(T, scale))
    fits = evidence.fits(starts)
    rows = len(evidence.residuals(fits[0].state))
    if 2 * fits[0].cost > rows + 4 * np.sqrt(2 * rows):
        came = f"residuals of {np.sqrt(2 * fits[0].cost / rows):.1f} sigmas at the best one"
        raise ScaleUnknown(f"expected one at which the touches fit the mesh, got {came}")
    variance = np.linalg.inv(fits[0].information)[6, 6]
    return _judged(evidence, fits, float(np.sqrt(variance)), bounds)


def _sweep(low: float, high: float) -> list[float]:
    """Returns scales from the least to the largest, at equal ratios."""
    count = int(np.ceil(np.log(high / low) / np.log(STEP))) + 1
    scales: list[float] = np.geomspace(low, high, max(count, 2)).tolist()
    return scales


def _judged(evidence: _Evidence, fits: list[_Fit], share: float, bounds: tuple[float, float]) -> Scale:
    """Returns the best scale; raises ScaleUnknown where it is open, or another one fits as well."""
    best = fits[0].state
    costs = np.array([fit.cost for fit in fits]) - fits[0].cost
    scales = np.array([fit.state.scale for fit in fits])
    off = np.log(scales / best.scale)
    # Minima near the best one, by their likelihoods; those that are symmetric have the same scale.
    near, first = np.unique(off.round(2), return_index=True)
    weights = np.exp(-costs[first]) * (np.abs(near) < STEP - 1)
    share = float(np.sqrt(share**2 + weights @ near**2 / weights.sum()))
    if not share <= MOST_SIGMA:
        spread = np.linalg.eigvalsh(evidence.normals.T @ evidence.normals)
        plane = ", as only a plane is seen" if spread[1] < FLAT * spread[2] else ""
        came = f"one that leaves it open by {100 * share:.0f} %{plane}"
        raise ScaleUnknown(f"expected evidence that fixes the scale, got {came}", (best.scale,))
    far = np.log(1 + max(3 * share, STEP / 2 - 0.5))
    rivals = scales[(costs < UNLIKELY) & (np.abs(off) > far)]
    if len(rivals):
        candidates = best.scale, float(rivals[0])
        raise ScaleUnknown("expected evidence that fits one scale, got several", candidates)
    if not bounds[0] / STEP < best.scale < bounds[1] * STEP:
        came = "one at the end of those that were tried"
        raise ScaleUnknown(f"expected a scale at which the object is about as large as seen, got {came}")
    return Scale(best.scale, best.scale * share, best.T)


def _edges(camera: Camera, depth: Depth, inside: Mask, gap: float) -> Array:
    """Returns places (m, 3) [m] half a pixel beside pixels of the object where what is behind is farther by a gap."""
    own = np.zeros_like(inside)
    own[3:-3, 3:-3] = inside[3:-3, 3:-3]
    found = list[Array]()
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        beside = np.zeros_like(depth)
        for step in (3, 2, 1):  # shadows have no depth
            other = np.roll(depth, (-step * down, -step * right), axis=(0, 1))
            beside = np.where(other > 0, other, beside)
        hit = own & (beside > depth + gap)
        slopes = camera.rays[hit] + 0.5 * np.array([right, down]) / camera.matrix.diagonal()[:2]
        found.append(np.column_stack([slopes, np.ones(len(slopes))]) * depth[hit][:, None])
    every = np.concatenate(found)
    return every[np.random.default_rng(0).permutation(len(every))[:RAYS]]


def _scaled(noise: DepthNoise, scale: float) -> DepthNoise:
    """Returns the errors of a camera whose depths are divided by a scale."""
    a, b, c = noise.axial
    return replace(
        noise,
        axial=(a / scale, b, c * scale),
        step=noise.step * scale,
        smooth=noise.smooth * scale,
        offset=noise.offset / scale,
    )


def _extent(points: Array) -> float:
    """Returns the largest distance between points (n, 3) [m], but for a few that lie apart."""
    some = points[:400]
    return float(np.quantile(np.linalg.norm(some[:, None] - some, axis=2).max(axis=1), 0.9))


def _narrowest(model: ObjectModel) -> float:
    """Returns how wide the mesh's silhouette is at least, in its widest direction, from any side [m]."""
    points = model.points_object
    return min(diameter(points - np.outer(points @ way, way)) for way in se3.directions(60))
