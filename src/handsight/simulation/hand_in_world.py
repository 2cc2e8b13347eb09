"""A hand as the simulated world takes it: the built-in Shadow hand, and any hand of a rig, are values of one type."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.hand.chains import ancestors, body_joints
from handsight.hand.couplings import Law
from handsight.hand.description import read_spec
from handsight.rig import Finger, Rig

if TYPE_CHECKING:
    from mujoco import MjModel, MjSpec


# The servos of a hand whose file says nothing of its motors.
SERVO_STIFFNESS = 3.0  # [N m/rad]
ARMATURE = 1e-3  # [kg m²]; links without an inertia move as if they had this one
SERVO_DAMPING = 0.11  # twice the root of stiffness times armature: critical [N m s/rad]
SLIDE_ARM = 0.05  # at which a sliding joint pushes, and is off, as a hinge is [m]
ARM_MASS = 4.0  # of what the arm carries [kg]
ARM_INERTIA = 0.02  # of the same [kg m²]
MIN_TIP_MASS = 1e-4  # of a tip whose rig declares none [kg]
PAD_MARGIN = 0.003  # of a contact from the end of the part of a tip that is sensed [m]
LINKAGE: dict[str, list[float]] = {"solref": [0.004, 1.0], "solimp": [0.99, 0.999, 0.001, 0.5, 2.0]}
"""How stiff a linkage or an arm is, as MuJoCo has it: as stiff as two milliseconds a step allow."""
MOST_DEGREES = 4
"""Of the polynomial by which a joint of MuJoCo follows another."""


@dataclass(frozen=True, slots=True, eq=False)
class TipInWorld:
    """A fingertip on a six-axis sensor, on a link of the hand."""

    link: str  # the body in the scene
    T_link_sensor: Array  # (4, 4)
    T_sensor_surface: Array  # (4, 4) pose of the ellipsoid's centre
    semi_axes: Array  # (3,) [m]
    mass: float  # [kg]
    center: Array  # (3,) centre of mass in the sensor's frame [m]
    unloaded: Array  # (6,) the sensor's reading without load [N, N m]
    sign: float  # 1 for a sensor that reads what the link does to the tip, -1 for one that reads the reverse
    pad: Array  # (3,) the direction in the ellipsoid in which a grasp should meet the object
    pad_cosine: float  # least cosine between it and the direction in which the object is

    @classmethod
    def of(cls, finger: Finger, link: str) -> "TipInWorld":
        """Returns the tip that a rig declares."""
        known, tip = finger.calibration, finger.tip
        T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
        across = max(tip.semi_axes[:2])
        along = tip.semi_axes[2]
        lowest = min((tip.cap or 0.0) + PAD_MARGIN, 0.95 * along)
        # An ellipsoid's point at that height has this normal.
        pad_cosine = across * lowest / np.sqrt(along**4 - lowest**2 * (along**2 - across**2))
        return cls(
            link=link,
            T_link_sensor=finger.T_frame_surface @ T_surface_sensor,
            T_sensor_surface=se3.inverse(T_surface_sensor),
            semi_axes=tip.semi_axes,
            mass=max(float(known.mass), MIN_TIP_MASS),
            center=known.center_of_mass,
            unloaded=np.concatenate([known.bias_force, known.bias_torque]),
            sign=1.0 if known.reading == "on_tip" else -1.0,
            pad=np.array([0.0, 0.0, 1.0]),
            pad_cosine=float(pad_cosine),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Follower:
    """How a joint without a servo follows another, by a linkage or a tendon."""

    leader: str  # empty: its position is constant
    law: Law  # its position by the leader's
    least: float = -np.inf  # a tendon is slack where its position would be below this

    def position(self, lead: float) -> float:
        """Returns its position where the leader is at `lead`."""
        return max(float(self.law(lead)), self.least)


@dataclass(frozen=True, slots=True, eq=False)
class HandInWorld:
    """Which bodies of a scene are a hand's, and how they move; each joint but the followers has a servo."""

    palm: str  # the body in whose frame poses are given
    mount: str  # the body that the arm carries
    T_mount_palm: Array  # (4, 4), constant
    tips: Mapping[str, TipInWorld]  # by finger
    joints: tuple[str, ...]  # names of its hinges and slides
    neighbours: Sequence[Sequence[str]]  # pairs of fingers whose tips collide
    grips: Sequence[Sequence[int]]  # numbers of the fingers of each kind of grip, the one that presses first
    grasping: tuple[str, ...]  # the joints that a grasp sets
    followers: Mapping[str, Follower]  # joints without a servo
    relaxed: Mapping[str, float]
    """Joints about which a search for a grasp begins; empty: in the middle of their range."""

    @property
    def coupled(self) -> tuple[str, ...]:
        """The followers that have no slack: their leaders say where they are."""
        return tuple(name for name, of in self.followers.items() if np.isneginf(of.least))


def servo_name(joint: str) -> str:
    """Returns the name of a joint's servo."""
    return joint.replace("robot0:", "robot0:A_")


def hand_of(rig: Rig, coupling_errors: tuple[float, ...] = ()) -> tuple["MjSpec", HandInWorld]:
    """Returns a scene with a rig's hand alone, and where it is in it.

    It has what moves with the palm; links collide with objects by their shapes' hulls, or only by their tips where the
    file has no shapes. Each joint has a position servo, or is coupled to one that has; `coupling_errors`: by how much
    each coupled joint of the hand is off its law [rad]; none: not at all. Raises InvalidInput for a rig with a
    fingertip without a force/torque sensor, and InvalidFile.
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
    spec.compiler.boundmass = 1e-6
    spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True
    spec.worldbody.add_frame().attach_body(own.body(model.body(root).name), "hand/", "")
    mount = spec.body(f"hand/{model.body(root).name}")
    for joint in list(mount.joints):
        spec.delete(joint)  # the arm's last one
    # A light body that an arm carries would make contacts soft.
    mount.explicitinertial = True
    mount.mass = ARM_MASS
    mount.inertia = np.full(3, ARM_INERTIA)
    tips = {finger: TipInWorld.of(part, f"hand/{part.frame}") for finger, part in rig.fingers.items()}
    joints = _joints(spec)
    followers = _followers(rig, joints)
    off = dict(zip(rig.hand.couplings.laws, coupling_errors, strict=False))
    driven = tuple(name for name in joints if name not in followers)
    _add_servos(spec, driven)
    for name, of in followers.items():
        _couple(spec, model, name, of, off.get(name, 0.0))
    colliding = [geom for geom in spec.geoms if geom.contype or geom.conaffinity] or list(spec.geoms)
    carriers = {_with_shapes(spec, tip.link) for tip in tips.values()}
    for geom in spec.geoms:
        geom.group = 4 if geom in colliding and len(colliding) < len(spec.geoms) else 1
        of_tip = geom.parent.name in carriers
        geom.contype = int(geom in colliding and not of_tip)
        geom.conaffinity = 0
        geom.priority = 0
        geom.margin = 0.0
        geom.mass = np.nan
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
        neighbours=list(combinations(tips, 2)),
        grips=_grips(len(tips)),
        grasping=driven,
        followers=followers,
        relaxed={},
    )


def _with_shapes(spec: "MjSpec", link: str) -> str:
    """Returns the link whose shapes are around a tip: its own, or, where that has none, the one that carries it."""
    body = spec.body(link)
    while not body.geoms and not body.joints and body.parent.name != spec.worldbody.name:
        body = body.parent
    return str(body.name)


def _grips(fingers: int) -> list[Sequence[int]]:
    """Returns all grips of one finger against up to three others, and at least two of a hand with three fingers."""
    fewest = 1 if fingers < 3 else 2
    return [
        (pressing, *others)
        for pressing in range(fingers)
        for count in range(fewest, 4)
        for others in combinations(np.delete(range(fingers), pressing).tolist(), count)
    ]


def _joints(spec: "MjSpec") -> tuple[str, ...]:
    """Returns the joints' names, which they get as the hand's file has them; raises InvalidInput."""
    import mujoco

    for joint in spec.joints:
        joint.name = joint.name.removeprefix("hand/")
        if joint.type not in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            raise InvalidInput(f"hand.file: expected hinges and slides, got {joint.name!r}")
        joint.armature = ARMATURE * _share(joint)
    return tuple(joint.name for joint in spec.joints)


def _followers(rig: Rig, joints: Collection[str]) -> dict[str, Follower]:
    """Returns those of some joints of a rig's hand that follow another one of them, or have a constant position."""
    found = dict[str, Follower]()
    for name, (leader, law) in rig.hand.couplings.laws.items():
        leads = not leader or leader in joints
        if leads and name in joints:
            found[name] = Follower(leader, law)
    return found


def _share(joint: Any) -> float:
    """Returns how much stiffer and heavier a joint's drive is than that of a hinge, in the joint's units."""
    import mujoco

    return SLIDE_ARM**-2 if joint.type == mujoco.mjtJoint.mjJNT_SLIDE else 1.0


def _add_servos(spec: "MjSpec", joints: tuple[str, ...]) -> None:
    """Adds a position servo to each of some joints."""
    import mujoco

    for name in joints:
        share = _share(spec.joint(name))
        actuator = spec.add_actuator(
            name=servo_name(name), target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
        actuator.gainprm[0] = SERVO_STIFFNESS * share
        actuator.biasprm[1:3] = -SERVO_STIFFNESS * share, -SERVO_DAMPING * share


def _couple(spec: "MjSpec", model: "MjModel", name: str, of: Follower, error: float) -> None:
    """Lets a joint follow its leader, off its law by `error` [rad]; `model` is that of the hand's file. Raises
    InvalidInput for a law that MuJoCo cannot have."""
    import mujoco

    # The linkage limits it, not the range in its file.
    spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
    # MuJoCo's law is one of distances from the reference pose.
    lead = model.joint(of.leader).qpos0[0] if of.leader else 0.0
    reference = model.joint(name).qpos0[0]
    from_reference = of.law(Law([lead, 1.0])) - reference
    arm = SLIDE_ARM if spec.joint(name).type == mujoco.mjtJoint.mjJNT_SLIDE else 1.0
    law = (from_reference + arm * error).trim()
    if law.degree() > MOST_DEGREES:
        expected = (
            f"expected a polynomial of {MOST_DEGREES} degrees at most, by which it follows {of.leader!r}"
        )
        raise InvalidInput(f"hand.file: joint {name!r}: {expected}, got one of {law.degree()}")
    data = np.zeros(mujoco.mjNEQDATA)
    data[: len(law.coef)] = law.coef
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=name, name2=of.leader,
        data=data, **LINKAGE,
    )  # fmt: skip
