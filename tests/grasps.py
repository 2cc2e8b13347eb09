"""Grasps with known truth, for the tests of correction."""

import functools

import numpy as np

import handsight as hs
from handsight import se3

SIGMA_POINT, SIGMA_NORMAL = 5e-4, np.deg2rad(2)


@functools.cache
def box():
    return hs.ObjectModel.box((0.060, 0.090, 0.140))


@functools.cache
def can():
    return hs.ObjectModel.cylinder(0.033, 0.115)


BOX_POINTS = np.array(
    [
        [0.030, 0.01, 0.03],
        [0.030, -0.02, -0.04],
        [-0.01, 0.045, 0.02],
        [0.015, 0.045, -0.03],
        [0.01, 0.02, 0.070],
    ]
)
BOX_NORMALS = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]])


def can_contacts():
    angle = np.array([0.2, 1.1, 2.3, 3.6, 5.0])
    height = np.array([0.02, -0.03, 0.01, -0.01, 0.03])
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=1)
    return 0.033 * normals + height[:, None] * [0, 0, 1], normals


def grasp(points_object, normals_object, seed, *, noise=1.0, error=(0.02, 0.2618)):
    """(contacts, vision, T_palm_object): noise in sigmas, vision wrong by a draw of its own covariance."""
    rng = np.random.default_rng(seed)
    T = se3.random(rng, spread=0.1)
    points = se3.apply(T, points_object) + noise * SIGMA_POINT * rng.normal(size=points_object.shape)
    tilt = noise * SIGMA_NORMAL * rng.normal(size=points.shape)
    normals = normals_object @ T[:3, :3].T
    normals = (se3.rotation_exp(np.cross(normals, tilt)) @ normals[..., None])[..., 0]
    contacts = hs.Contacts(points, normals, sigma_point=SIGMA_POINT, sigma_normal=SIGMA_NORMAL)
    sigma = np.repeat(np.asarray(error) / np.sqrt(3), 3)
    return contacts, hs.PosePrior(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2)), T


def off(T, T_reference):
    """Shift [m] and turn [rad] between two poses."""
    delta = se3.difference(T, T_reference)
    return np.linalg.norm(delta[:3]), np.linalg.norm(delta[3:])
