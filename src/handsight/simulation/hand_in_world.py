"""A hand as the simulated world takes it: the built-in Shadow hand, and any hand of a rig, are values of one type."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.hand.chains import ancestors, body_joints
from handsight.hand.description import read_spec
from handsight.rig import Finger, Rig

if TYPE_CHECKING:
    from mujoco import MjSpec


class ServoOptions(NamedTuple):
    """`ServoOptions` are the servos of a hand whose file says nothing of its motors."""

    stiffness: float = 3.0  # [N m/rad]
    armature: float = 1e-3  # [kg m²]; links without an inertia move as if they had this one
    damping: float = 0.11  # twice the root of stiffness times armature: critical [N m s/rad]
    arm: float = 0.05  # at which a sliding joint pushes as a hinge does [m]
    arm_mass: float = 4.0  # of what the arm carries [kg]
    arm_inertia: float = 0.02  # of the same [kg m²]
    min_tip_mass: float = 1e-4  # of a tip whose rig declares none [kg]


SERVO = ServoOptions()


@dataclass(frozen=True, slots=True, eq=False)
class TipInWorld:
    """A `TipInWorld` is a fingertip on a six-axis sensor, on a link of the hand."""

    link: str  # the body in the scene
    T_link_sensor: Array  # (4, 4)
    T_sensor_surface: Array  # (4, 4) pose of the ellipsoid's centre
    semi_axes: Array  # (3,) [m]
    mass: float  # [kg]
    center: Array  # (3,) centre of mass in the sensor's frame [m]
    unloaded: Array  # (6,) the sensor's reading without load [N, N m]
    sign: float  # 1 for a sensor that reads what the link does to the tip, -1 for one that reads the reverse

    @classmethod
    def of(cls, finger: Finger, link: str) -> "TipInWorld":
        """Returns the tip that a rig declares."""
        known, tip = finger.calibration, finger.tip
        T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
        return cls(
            link=link,
            T_link_sensor=finger.T_frame_surface @ T_surface_sensor,
            T_sensor_surface=se3.inverse(T_surface_sensor),
            semi_axes=tip.semi_axes,
            mass=max(float(known.mass), SERVO.min_tip_mass),
            center=known.center_of_mass,
            unloaded=np.concatenate([known.bias_force, known.bias_torque]),
            sign=1.0 if known.reading == "on_tip" else -1.0,
        )


@dataclass(frozen=True, slots=True, eq=False)
class HandInWorld:
    """A `HandInWorld` says which bodies of a scene are a hand's; each of its joints has a servo."""

    palm: str  # the body in whose frame poses are given
    mount: str  # the body that the arm carries
    T_mount_palm: Array  # (4, 4), constant
    tips: Mapping[str, TipInWorld]  # by finger
    joints: tuple[str, ...]  # names of its hinges and slides
    neighbours: tuple[tuple[str, str], ...]  # pairs of fingers whose tips collide


def servo_name(joint: str) -> str:
    """Returns the name of a joint's servo."""
    return joint.replace("robot0:", "robot0:A_")


def hand_of(rig: Rig) -> tuple["MjSpec", HandInWorld]:
    """Returns a scene with a rig's hand alone, and where it is in it.

    It has what moves with the palm; links collide with objects by their shapes' hulls, or only by their tips where the
    file has no shapes; each joint has a position servo (`ServoOptions`). Raises InvalidInput for a rig with a fingertip
    without a force/torque sensor, and InvalidFile.
    """
    import mujoco

    if lacking := [finger for finger in rig.fingers if finger not in rig.topics.wrenches]:
        raise InvalidInput(
            f"topics.wrenches: expected one for each fingertip that is simulated, got none for {lacking[0]}"
        )
    own, model = read_spec(rig.hand.file)
    palm = model.body(rig.hand.palm).id
    upward = ancestors(model, palm)
    root = next((body for body in upward if body_joints(model, body)), upward[-1])
    spec = mujoco.MjSpec()
    spec.assets = own.assets
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-6, 1e-9
    spec.compiler.balanceinertia = True
    spec.worldbody.add_frame().attach_body(own.body(model.body(root).name), "hand/", "")
    mount = spec.body(f"hand/{model.body(root).name}")
    for joint in list(mount.joints):
        spec.delete(joint)  # the arm's last one
    # A light body that an arm carries would make contacts soft.
    mount.explicitinertial, mount.mass, mount.inertia = True, SERVO.arm_mass, np.full(3, SERVO.arm_inertia)
    tips = {finger: TipInWorld.of(part, f"hand/{part.frame}") for finger, part in rig.fingers.items()}
    joints = _add_servos(spec)
    colliding = [geom for geom in spec.geoms if geom.contype or geom.conaffinity] or list(spec.geoms)
    for geom in spec.geoms:
        geom.group = 4 if geom in colliding and len(colliding) < len(spec.geoms) else 1
        of_tip = geom.parent.name in {tip.link for tip in tips.values()}
        geom.contype, geom.conaffinity = int(geom in colliding and not of_tip), 0
        geom.priority, geom.margin, geom.mass = 0, 0.0, np.nan
    T_mount_palm = np.eye(4)
    for body in reversed(upward[: upward.index(root)]):
        R = se3.rotation_from_quaternion(np.roll(model.body_quat[body], -1))
        T_mount_palm = T_mount_palm @ se3.compose(R, model.body_pos[body])
    return spec, HandInWorld(
        palm=f"hand/{rig.hand.palm}",
        mount=mount.name,
        T_mount_palm=T_mount_palm,
        tips=tips,
        joints=joints,
        neighbours=tuple((a, b) for i, a in enumerate(tips) for b in [*tips][i + 1 :]),
    )


def _add_servos(spec: "MjSpec") -> tuple[str, ...]:
    """Adds a position servo to each joint, and returns the joints' names as the hand's file has them."""
    import mujoco

    joints = []
    for joint in spec.joints:
        joint.name = joint.name.removeprefix("hand/")
        slide = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        if not slide and joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            raise InvalidInput(f"hand.file: expected hinges and slides, got {joint.name!r}")
        share = SERVO.arm**-2 if slide else 1.0
        joint.armature = SERVO.armature * share
        actuator = spec.add_actuator(
            name=servo_name(joint.name), target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
        actuator.gainprm[0] = SERVO.stiffness * share
        actuator.biasprm[1:3] = -SERVO.stiffness * share, -SERVO.damping * share
        joints.append(joint.name)
    return tuple(joints)
