"""What the tests of the simulation share: short simulations, and contacts sensed from what they measured."""

import dataclasses
import functools

import numpy as np

import shared
from handsight import se3
from handsight.contact import Contact, compensate, contact_from_wrench
from handsight.simulation import Nuisances, Scenario, rig_of

NONE = Nuisances.none()


@functools.cache
def samples(kind="can", seed=0, motion="grasp", rate=10.0, nuisances=NONE):
    """All samples of a scenario; nuisances off unless told."""
    return tuple(
        shared.simulated(Scenario(object=kind, seed=seed, motion=motion, rate=rate, nuisances=nuisances))
    )


def only(**settings):
    """These nuisances and no other."""
    return dataclasses.replace(NONE, **settings)


def sensed(observation):
    """By finger: (contact in the palm frame or None, force on the tip in the palm frame), from raw wrenches and joints."""
    rig = rig_of(Scenario())
    gravity_palm = observation.T_world_palm[:3, :3].T @ rig.gravity
    found = {}
    for name, T_palm_frame in zip(
        rig.hand.tips, rig.hand.Ts_palm_tip(observation.joint_positions), strict=True
    ):
        finger = rig.fingers[name]
        T_palm_surface = T_palm_frame @ finger.T_frame_surface
        R_palm_sensor = (T_palm_surface @ finger.tip.T_surface_sensor)[:3, :3]
        raw = observation.wrenches[name]
        force, torque = compensate(raw[:3], raw[3:], R_palm_sensor.T @ gravity_palm, finger.calibration)
        contact = contact_from_wrench(force, torque, finger.tip)
        point = None
        if isinstance(contact, Contact):
            point = se3.apply(T_palm_surface, contact.point[None])[0]
        found[name] = point, R_palm_sensor @ force
    return found


def location_errors(sample):
    """How far sensed points are from the simulator's [m], of tips that touch the object and nothing else."""
    errors = []
    for finger, (point, _) in sensed(sample.observation).items():
        touches = [touch for touch in sample.contacts_truth if touch.finger == finger]
        if len(touches) == 1 and touches[0].other == "object":
            assert point is not None, f"{finger} touches the object and feels nothing"
            errors.append(np.linalg.norm(point - touches[0].point_palm))
    return errors
