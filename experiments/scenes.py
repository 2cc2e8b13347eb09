"""Synthetic grasps with a known pose: what the experiments draw their problems from."""

from dataclasses import dataclass

import numpy as np

import handsight as hs
from handsight import se3

CAN = {"radius": 0.033, "height": 0.115}
BOX = (0.060, 0.090, 0.140)


@dataclass(frozen=True)
class Scene:
    """One grasp: what the hand measured, and the truth it does not know."""

    contacts: hs.Contacts
    vision: hs.PosePrior
    T_palm_object: np.ndarray
    points_object: np.ndarray
    """(n, 3) where the contacts truly are, object frame [m]."""
    normals_object: np.ndarray


def tilted(normals, sigma, rng):
    """Unit vectors turned by N(0, sigma) [rad] about each of two tangent axes."""
    tangent = rng.normal(size=normals.shape) * sigma
    tangent -= (tangent * normals).sum(axis=1, keepdims=True) * normals
    R = se3.rotation_exp(np.cross(normals, tangent))
    return (R @ normals[..., None])[..., 0]


def on_can_side(rng, n=5, radius=CAN["radius"], height=CAN["height"]):
    """n points and normals on a can's side, object frame."""
    angle = rng.uniform(0, 2 * np.pi, n)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    return radius * normals + np.outer(rng.uniform(-0.45, 0.45, n) * height, [0, 0, 1]), normals


def on_box_faces(rng, n=5, size=BOX, faces=None):
    """n points and normals on a box, on the given faces (0-5: +x -x +y -y +z -z) or three random ones."""
    faces = rng.choice(6, 3, replace=False) if faces is None else np.asarray(faces)
    which = faces[np.arange(n) % len(faces)]
    points = rng.uniform(-0.45, 0.45, (n, 3)) * np.asarray(size)
    normals = np.zeros((n, 3))
    rows = np.arange(n)
    normals[rows, which // 2] = 1 - 2 * (which % 2)
    points[rows, which // 2] = normals[rows, which // 2] * np.asarray(size)[which // 2] / 2
    return points, normals


NOISE, ERROR = (5e-4, np.deg2rad(2)), (0.02, np.deg2rad(15))


def grasp(points_object, normals_object, rng, *, noise=NOISE, error=ERROR):
    """The scene of these contacts: a random pose, contact noise per axis, vision wrong by a Gaussian draw.

    `error`: root mean square length of vision's shift [m] and turn [rad]; its sigmas are per axis, and true.
    """
    T = se3.random(rng, spread=0.1)
    sigma_point, sigma_normal = noise
    points = se3.apply(T, points_object) + sigma_point * rng.normal(size=points_object.shape)
    normals = tilted(normals_object @ T[:3, :3].T, sigma_normal, rng)
    contacts = hs.Contacts(points, normals, sigma_point=sigma_point, sigma_normal=sigma_normal)
    sigma = np.repeat(np.asarray(error) / np.sqrt(3), 3)
    T_vision = se3.moved(T, sigma * rng.normal(size=6))
    return Scene(contacts, hs.PosePrior(T_vision, np.diag(sigma**2)), T, points_object, normals_object)


def pose_errors(model, estimate, T_palm_object):
    """Errors modulo symmetry of an estimate: shift of the middle [m] and turn [rad], all and observable."""
    T_hat = estimate.T_palm_object
    truth = nearest_truth(model, T_palm_object, T_hat)
    delta = se3.difference(T_hat, truth) * np.repeat([1.0, model.radius], 3)
    open_ = estimate.unobservable
    seen = delta - open_.T @ (open_ @ delta) if len(open_) else delta
    scale = np.repeat([1.0, 1 / model.radius], 3)
    return [np.linalg.norm(v) for d in (delta, seen) for v in np.split(d * scale, 2)]


CUBE = (0.10, 0.10, 0.10)
CYLINDER = {"radius": 0.05, "height": 0.10}
CLOUD = 2000
"""Points in the cloud of the paper's method; its contacts are selected among them, as the paper did."""
START = (0.02, np.deg2rad(20))
"""Table I's error of the first pose: the shift's standard deviation per axis [m], the whole turn [rad]."""


def table_1_models():
    """The paper's two simulated objects."""
    return {"cube": hs.ObjectModel.box(CUBE), "cylinder": hs.ObjectModel.cylinder(**CYLINDER)}


def on_four_sides(model, rng):
    """Four points and normals, object frame, out of the model's own cloud.

    On a box: on four of the six faces. On a cylinder: three on the side, 120° apart and each up to 15° off
    that, and one on the top.
    """
    points, normals = model.sample(CLOUD)
    if model.symmetries.axes:
        side, top = np.flatnonzero(np.abs(normals[:, 2]) < 0.5), np.flatnonzero(normals[:, 2] > 0.5)
        angles = np.deg2rad(rng.uniform(0, 360) + np.arange(0, 360, 120) + rng.uniform(-15, 15, 3))
        toward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        near = [side[np.argsort(-normals[side, :2] @ direction)[:20]] for direction in toward]
        chosen = [rng.choice(group) for group in [*near, top]]
    else:
        outward = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)[:4]]
        chosen = [rng.choice(np.flatnonzero(normals @ direction > 0.9)) for direction in outward]
    return points[chosen], normals[chosen]


def on_box_edges(rng, near):
    """Four points and normals on different faces of `BOX`: all 1-5 mm from an edge, or 15 mm from any."""
    half = np.array(BOX) / 2
    outward = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)[:4]]
    points = outward * half
    for point, normal in zip(points, outward, strict=True):
        a, b = rng.permutation(np.flatnonzero(normal == 0))
        point[[a, b]] = rng.uniform(-1, 1, 2) * (half[[a, b]] - 0.015)
        if near:
            point[a] = rng.choice([-1, 1]) * (half[a] - rng.uniform(0.001, 0.005))
    return points, outward


def displaced(points_object, normals_object, rng, *, start=START, noise=(0.0, 0.0), sigmas=None):
    """The scene of these contacts as the paper simulates it: the object is seen at the palm's origin.

    Its true pose is N(0, start[0]²) off along each axis [m], and start[1] about a random axis [rad]. Contacts
    have `noise` per axis (point [m], normal [rad]) and say `sigmas`, which defaults to the noise.
    """
    axis = rng.normal(size=3)
    shift = start[0] * rng.normal(size=3)
    T = se3.moved(np.eye(4), np.concatenate([shift, start[1] * axis / np.linalg.norm(axis)]))
    points = se3.apply(T, points_object) + noise[0] * rng.normal(size=points_object.shape)
    normals = tilted(normals_object @ T[:3, :3].T, noise[1], rng)
    sigma_point, sigma_normal = noise if sigmas is None else sigmas
    contacts = hs.Contacts(points, normals, sigma_point=sigma_point, sigma_normal=sigma_normal)
    vision = hs.PosePrior.from_sigmas(np.eye(4), start[0], start[1] / np.sqrt(3))
    return Scene(contacts, vision, T, points_object, normals_object)


def without_normals(contacts, sigma_point):
    """The same contact points alone."""
    return hs.Contacts(contacts.points_palm, sigma_point=sigma_point)


def nearest_truth(model, T_palm_object, T_hat):
    """The true pose, moved along the declared symmetries to the nearest to an estimate."""
    from handsight.objects.symmetry import nearest

    return nearest(model.symmetries, T_palm_object, T_hat, model.radius)


def at_least_as_probable(model, scene, estimate):
    """Whether the answer is at least as probable as the optimum reached from the truth itself.

    If so a miss is an information limit; if not, the solver failed.
    """
    sure = hs.PosePrior(scene.T_palm_object, scene.vision.covariance)
    from_truth = hs.correct_pose(model, scene.contacts, vision=sure, method=hs.TwoPhase(starts=1))
    ours, theirs = (cost_at(model, scene, e.T_palm_object) for e in (estimate, from_truth))
    return bool(ours <= theirs + 1.0)


def cost_at(model, scene, T_palm_object):
    """Squared residuals of contacts and vision at a pose, whitened by their sigmas."""
    from handsight.objects.symmetry import nearest

    points = se3.apply(se3.inverse(T_palm_object), scene.contacts.points_palm)
    values = model.fine.evaluate(points)
    normals = values.gradient / np.linalg.norm(values.gradient, axis=1, keepdims=True)
    felt = scene.contacts.normals_palm @ T_palm_object[:3, :3]
    variances = np.diagonal(scene.contacts.covariance, axis1=1, axis2=2)
    cost = (values.distance**2 / variances[:, 0]).sum()
    cost += (((normals - felt) ** 2).sum(axis=1) / (variances[:, 3:].sum(axis=1) / 2)).sum()
    vision = scene.vision.T_palm_object
    delta = se3.difference(nearest(model.symmetries, T_palm_object, vision, model.radius), vision)
    return cost + delta @ np.linalg.solve(scene.vision.covariance, delta)


def anywhere_on(model):
    """How contacts are drawn uniformly over a model's surface."""

    def draw(rng, n=5):
        return model.sample(n, seed=int(rng.integers(1 << 31)))

    return draw


def contact_errors(model, scene, T_hat):
    """A pose's mean error of the contacts' places on the object [m], and its turn [rad], modulo symmetry."""
    T_near = nearest_truth(model, scene.T_palm_object, T_hat)
    here, there = (se3.apply(se3.inverse(T), scene.contacts.points_palm) for T in (T_hat, T_near))
    turn = se3.rotation_log(T_hat[:3, :3] @ T_near[:3, :3].T)
    return float(np.linalg.norm(here - there, axis=1).mean()), float(np.linalg.norm(turn))
