"""Raw wrenches to contacts in the palm, a finger at a time and in plain steps: the slow truth of the kernel."""

import numpy as np

from handsight import se3
from handsight.contact import Reason, compensate
from oracles.sensing import sense


def contact_in_palm(finger, reading, T_palm_tip, jacobian, gravity_palm, variance_joint):
    """Reason, point (3,), normal (3,), covariance (6, 6) and load (5,) in the palm; None where there is no contact.

    `finger`: of a rig. `jacobian` (6, j): of the origin of `T_palm_tip`.
    """
    tip = finger.tip
    T = T_palm_tip @ finger.T_frame_surface
    T_palm_sensor = T if tip.T_surface_sensor is None else T @ tip.T_surface_sensor
    if not np.isfinite(reading).all():
        return Reason.INVALID, None, None, None, None
    gravity_sensor = T_palm_sensor[:3, :3].T @ gravity_palm
    force, torque = compensate(reading[:3], reading[3:], gravity_sensor, finger.calibration)
    noise = np.repeat([finger.sigma_force, finger.sigma_torque], 3)
    sigmas = np.hypot(noise, finger.sigma_gain * np.r_[force, torque])
    sensed = sense(force[None], torque[None], tip, sigmas)
    if sensed.reasons[0] != Reason.CONTACT:
        return sensed.reasons[0], None, None, None, None
    R = T[:3, :3]
    point, normal = R @ sensed.points[0] + T[:3, 3], R @ sensed.normals[0]
    turn = jacobian[3:]
    moves = jacobian[:3] - se3.skew(point - T_palm_tip[:3, 3]) @ turn
    # A turn ω of the tip moves its normal by ω × n.
    by_joint = np.vstack([moves, -se3.skew(normal) @ turn])
    covariance = se3.rotate_covariance(R, sensed.covariances[0]) + variance_joint * by_joint @ by_joint.T
    covariance += np.diag(np.repeat([finger.sigma_point**2, finger.sigma_normal**2], 3))
    tangent = np.eye(6)
    tangent[3:, 3:] -= np.outer(normal, normal)
    load = R @ sensed.forces[0] - sensed.forces_normal[0] * normal
    load = np.r_[load, sensed.forces_normal[0], sensed.torques[0]]
    return Reason.CONTACT, point, normal, tangent @ covariance @ tangent, load
