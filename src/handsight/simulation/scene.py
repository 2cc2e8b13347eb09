"""The scene in MuJoCo: a hand with ellipsoidal fingertips on six-axis sensors, object, table, camera.

World: the table's top is at height 0, z up; the object stands at the origin until it is moved. The forearm comes from
-x, so the table ends shortly before the object on that side.
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject, MissingExtra, needing
from handsight.hand.couplings import Law
from handsight.objects import Library
from handsight.rig import Rig
from handsight.simulation.hand_in_world import LINKAGE, Follower, HandInWorld, TipInWorld, hand_of
from handsight.simulation.scenario import FINGERS, OBJECT_MASS, STEPS_PER_SECOND, TORSION_ARM
from handsight.simulation.tables import tables

if TYPE_CHECKING:
    from mujoco import MjSpec


HAND_FILE = "envs/assets/hand/reach.xml"  # within gymnasium-robotics; its only scene without an object
PALM = "robot0:palm"
PALM_GEOM = "robot0:C_palm0"  # the geom that a tactile array of the palm covers
T_MOUNT_PALM = se3.translation([0.0, 0.01, 0.29])
"""(4, 4) of the palm in the hand's mount, with the wrist straight."""

TipErrors = tuple[tuple[float, float], ...]


COUPLING = 1.142
SLACK = 0.142
"""Of the tendon of the last two joints of the Shadow hand's fingers: the ratio by which the last follows the other, and
by how much it is behind at most [rad]."""
SENSOR_Z = 0.002
"""Of a sensor's frame along its distal link [m]."""
TIP_MASS = 0.004
"""Of a tip [kg]."""
FOCAL_LENGTH = 525.0
"""Of the camera's images, as a Kinect's [pixels]."""
SUPERSAMPLING = 2
"""Factor by which a picture for people is drawn larger, each way, and averaged."""
TABLE_BIT = 2
"""Collision bit of object and fingertips: nothing else collides with the table. A random draw may lower the palm's edge
some millimetres into the table, where a collision would bend the wrist."""
GRAVITY = np.array([0.0, 0.0, -9.81])
UNLOADED = np.array([tip["unloaded"] for tip in tables()["shadow_tips"].values()])
"""(5, 6) readings of the fingers' sensors without load [N, N m]; the rig's calibration has the same."""
CAN_SIZE = tuple[float, float](tables()["can"])  # radius and height [m]
BOX_SIZE = tuple[float, float, float](tables()["box"])  # sides [m]
IMAGE_SIZE = (640, 480)  # width and height of the camera's images, a Kinect's [pixels]


def stiffness(softness: float) -> dict[str, list[float]]:
    """Returns the contact stiffness, for `contact_softness`. With MuJoCo's defaults tips sink in by 0.5 mm, which moves
    sensed points by 0.2 mm; with contacts much stiffer than the usual ones the hand drops objects."""
    k = 1 + softness
    return {"solref": [0.01 * k, 1.0], "solimp": [1 - 0.05 * k, 1 - 0.01 * k, 0.001, 0.5, 2.0]}


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScene:
    """A compiled scene, the same for all draws of one object. Its bodies are PALM, `object`, and
    one that ends in `_tip` for each finger."""

    model: Any  # mujoco.MjModel, never changed after this
    joints: dict[str, int]  # places of the hand's joints in qpos, by name
    tips: dict[int, str]  # names of fingers by their tip's geom
    bounds_object: Array  # (2, 3) in the object's frame [m]
    hand: HandInWorld


def tip_shape(finger: str) -> tuple[Array, float]:
    """Returns the semi-axes (3,) of a fingertip and its centre's z from the sensor's frame [m]."""
    tip = tables()["shadow_tips"][finger]
    return np.array(tip["semi_axes"]), tip["height"] - SENSOR_Z


def mujoco_module() -> ModuleType:
    """Returns mujoco; raises MissingExtra."""
    with needing("simulation needs mujoco", "sim"):
        return import_module("mujoco")


@lru_cache(maxsize=8)
def scene(
    name: str,
    mass: float = OBJECT_MASS,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    friction: float = 1.0,
    pyramidal: bool = False,
    softness: float = 0.0,
    tip_errors: TipErrors = (),
    coupling_errors: tuple[float, ...] = (),
    rig: Rig | None = None,
) -> SimulatedScene:
    """Returns the scene with an object: `name` is `can`, `box`, a mesh file or in the library; and the hand of a
    rig, or the Shadow hand.

    The object has that mass [kg], its centre of mass is displaced by `shift` [m]; `friction` and `tip_errors`, of
    radius and length [m], are the tips', `coupling_errors` [rad] the coupled joints'. Raises MissingExtra without
    mujoco or gymnasium-robotics, InvalidFile or InvalidObject for a mesh that cannot be used.
    """
    mujoco = mujoco_module()
    spec, hand = _shadow_hand(mujoco) if rig is None else hand_of(rig, coupling_errors)
    spec.option.gravity = GRAVITY
    spec.option.timestep = 1 / STEPS_PER_SECOND
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.iterations = 100
    spec.option.tolerance = 1e-10
    cones = mujoco.mjtCone
    spec.option.cone = cones.mjCONE_PYRAMIDAL if pyramidal else cones.mjCONE_ELLIPTIC
    spec.option.impratio = 50.0 if pyramidal else 10.0  # else a pyramid lets a held object creep
    _add_tips(mujoco, spec, hand, friction, softness, tip_errors or ((0.0, 0.0),) * len(hand.tips))
    _carry(mujoco, spec, hand)
    _add_table_and_camera(mujoco, spec)
    _add_object(mujoco, spec, name, softness)
    model = spec.compile()
    if mass != OBJECT_MASS or any(shift):
        # The inertia about the centre of mass is proportional to the mass.
        body = spec.body("object")
        usual = model.body("object")
        body.explicitinertial = True
        body.mass = mass
        body.ipos = usual.ipos + shift
        body.iquat = usual.iquat
        body.inertia = usual.inertia * (mass / usual.mass[0])
        model = spec.compile()
    return SimulatedScene(
        model=model,
        joints={name: int(model.joint(name).qposadr[0]) for name in hand.joints},
        tips={model.geom(f"{finger}_tip").id: finger for finger in hand.tips},
        bounds_object=bounds(name),
        hand=hand,
    )


def hand_file() -> Path:
    """Returns the path of the hand's file in gymnasium-robotics; raises MissingExtra."""
    found = find_spec("gymnasium_robotics")  # importing it prints
    if found is None or found.origin is None:
        raise MissingExtra("simulation needs gymnasium-robotics: pip install 'handsight[sim]'")
    return Path(found.origin).parent / HAND_FILE


def _shadow_hand(mujoco: ModuleType) -> tuple["MjSpec", HandInWorld]:
    """Returns a scene with the Shadow hand alone, its distal links without their collision shapes."""
    spec = mujoco.MjSpec.from_file(str(hand_file()))
    spec.delete(spec.geom("floor0"))
    spec.delete(spec.body("floor0"))  # it carries the marks of that file's task
    replaced = {f"robot0:C_{finger}distal" for finger in FINGERS}
    for pair in list(spec.pairs):
        if pair.geomname1 in replaced or pair.geomname2 in replaced:
            spec.delete(pair)
    tips = {}
    for finger, unloaded in zip(FINGERS, UNLOADED, strict=True):
        semi_axes, center_z = tip_shape(finger)
        spec.delete(spec.geom(f"robot0:C_{finger}distal"))
        spec.geom(f"robot0:V_{finger}distal").group = 5  # is not drawn
        center = np.array([0.0, 0.0, center_z])
        tips[finger] = TipInWorld(
            link=f"robot0:{finger}distal",
            T_link_sensor=se3.translation([0.0, 0.0, SENSOR_Z]),
            T_sensor_surface=se3.translation(center),
            semi_axes=semi_axes,
            mass=TIP_MASS,
            center=center,
            unloaded=unloaded,
            sign=1.0,
            pad=np.array(tables()["shadow_tips"][finger]["pad"]),
            pad_cosine=0.85,
        )
    mount = spec.body("robot0:hand mount")
    mount.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # else its Euler angles override the quaternion
    joints = tuple(joint.name for joint in spec.joints)
    tendon = Law([-SLACK, COUPLING])
    followers = {
        f"robot0:{finger}J0": Follower(f"robot0:{finger}J1", tendon, least=0.0)
        for finger in ("FF", "MF", "RF", "LF")
    }
    return spec, HandInWorld(
        palm=PALM,
        mount=mount.name,
        T_mount_palm=T_MOUNT_PALM,
        tips=tips,
        joints=joints,
        neighbours=tables()["neighbours"],
        grips=tables()["grips"],
        grasping=tuple(name for name in joints if name not in followers and "WR" not in name),
        followers=followers,
        relaxed=tables()["relaxed"],
    )


def _add_tips(
    mujoco: ModuleType, spec: "MjSpec", hand: HandInWorld, friction: float, softness: float, errors: TipErrors
) -> None:
    """Adds the ellipsoid of each fingertip on a sensor, which measures every force on it."""
    for (finger, of), (wider, longer) in zip(hand.tips.items(), errors, strict=True):
        tip = spec.body(of.link).add_body(name=f"{finger}_tip", **_placed(of.T_link_sensor))
        semi_axes = of.semi_axes + np.array([wider, wider, longer])
        tip.add_geom(
            name=f"{finger}_tip", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=semi_axes, mass=of.mass,
            contype=1 | TABLE_BIT, conaffinity=0, condim=4, **_placed(of.T_sensor_surface),
            friction=[friction, TORSION_ARM * friction, 0.0001],
            priority=1, margin=0.0, rgba=tables()["drawn"]["tips"],
            **stiffness(softness),
        )  # fmt: skip
        if not np.array_equal(of.center, of.T_sensor_surface[:3, 3]):
            tip.explicitinertial = True
            tip.mass = of.mass
            tip.ipos = of.center
            tip.inertia = of.mass * of.semi_axes.max() ** 2 * np.full(3, 0.4)
        tip.add_site(name=f"{finger}_ft")
        site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": f"{finger}_ft"}
        spec.add_sensor(name=f"{finger}_force", type=mujoco.mjtSensor.mjSENS_FORCE, **site)
        spec.add_sensor(name=f"{finger}_torque", type=mujoco.mjtSensor.mjSENS_TORQUE, **site)
    # The hand's geoms collide only in declared pairs.
    for a, b in hand.neighbours:
        spec.add_pair(geomname1=f"{a}_tip", geomname2=f"{b}_tip", condim=1)


def rows(Ts: Array) -> Array:
    """Returns positions and quaternions (..., 7) of poses (..., 4, 4); a quaternion's w is first, as in MuJoCo."""
    xyzw = se3.quaternion_from_rotation(Ts[..., :3, :3])
    return np.concatenate([Ts[..., :3, 3], np.roll(xyzw, 1, axis=-1)], axis=-1)


def _placed(T: Array) -> dict[str, Array]:
    """Returns position and quaternion of a pose (4, 4) by their names in MuJoCo."""
    row = rows(T)
    return {"pos": row[:3], "quat": row[3:]}


def _carry(mujoco: ModuleType, spec: "MjSpec", hand: HandInWorld) -> None:
    """Lets the hand float, welded to a mocap body that represents the arm."""
    mount = spec.body(hand.mount)
    mount.pos = [0, 0, 0]
    mount.quat = [1, 0, 0, 0]
    mount.add_freejoint(name="mount")
    spec.worldbody.add_body(name="arm", mocap=True)
    data = np.zeros(mujoco.mjNEQDATA)
    data[6] = data[10] = 1.0  # the quaternion's w, and a torque scale of 1
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="arm", name2=hand.mount,
        data=data, **LINKAGE,
    )  # fmt: skip
    # As under a robot's controller, arm and hand are weightless; the tips' weight stays, for sensors measure it.
    for body in spec.bodies:
        if body.name.startswith(("robot0:", "hand/")):
            body.gravcomp = 1.0


def _add_table_and_camera(mujoco: ModuleType, spec: "MjSpec") -> None:
    """Adds table, camera and lights, and sets how they are drawn."""
    drawn = tables()["drawn"]
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 0  # smoothing by the driver costs five times as much
    spec.visual.global_.offwidth = SUPERSAMPLING * IMAGE_SIZE[0]
    spec.visual.global_.offheight = SUPERSAMPLING * IMAGE_SIZE[1]
    spec.stat.extent = 1.0  # the unit of the near and the far plane
    spec.visual.map.znear = 0.02
    spec.visual.map.zfar = 10.0
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="background", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        **drawn["background"],
    )  # fmt: skip
    low, high = np.array(tables()["table"]).T
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, pos=(low + high) / 2, size=(high - low) / 2,
        contype=0, conaffinity=TABLE_BIT, friction=[0.4, 0.005, 0.0001], priority=1,
        rgba=drawn["table"], **stiffness(0.0),
    )  # fmt: skip
    fovy = float(np.rad2deg(2 * np.arctan(IMAGE_SIZE[1] / 2 / FOCAL_LENGTH)))
    spec.worldbody.add_camera(name="camera", fovy=fovy)
    _light(spec.visual.headlight, drawn["headlight"])
    if spec.light("light0") is not None:  # of the Shadow hand's file
        _light(spec.light("light0"), drawn["light_of_hand"])
    spec.worldbody.add_light(**drawn["light"])


def _light(light: Any, values: dict[str, list[float]]) -> None:
    light.ambient = values["ambient"]
    light.diffuse = values["diffuse"]


def _add_object(mujoco: ModuleType, spec: "MjSpec", name: str, softness: float) -> None:
    """Adds the object, a mesh as its convex hull."""
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    drawn = tables()["drawn"]
    if name == "can":
        radius, height = CAN_SIZE
        shape = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [radius, height / 2, 0]}
    elif name == "box":
        shape = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": np.array(BOX_SIZE) / 2}
    else:
        vertices, faces = convex_hull(name)
        spec.add_mesh(name="object", uservert=vertices.ravel(), userface=faces.ravel())
        shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "object"}
    body.add_geom(
        name="object", mass=OBJECT_MASS, condim=4, friction=[1.0, 0.005, 0.0001],
        contype=1 | TABLE_BIT, conaffinity=1, rgba=drawn["box" if name == "box" else "others"],
        **shape, **stiffness(softness),
    )  # fmt: skip


def bounds(name: str) -> Array:
    """Returns the bounds (2, 3) of an object in its own frame [m]; `name` as `scene` takes it."""
    vertices, _ = convex_hull(name)
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


@lru_cache(maxsize=8)
def convex_hull(path: str) -> tuple[Array, Any]:
    """Returns vertices (k, 3) [m] and faces (m, 3) of an object's convex hull; `path` as `scene` takes `name`."""
    import trimesh

    if path in ("can", "box"):
        creation = trimesh.creation
        mesh = creation.box(BOX_SIZE) if path == "box" else creation.cylinder(*CAN_SIZE, sections=64)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)

    from handsight.objects.files import read_shape

    shape = read_shape(path) if Path(path).suffix else Library().model(path)
    vertices = shape.vertices
    name = Path(path).name
    extent = float(np.ptp(vertices, axis=0).max())
    if not extent <= 0.5:  # a larger mesh is not in metres, or fits in no hand
        raise InvalidObject(f"{name}: expected metres, at most 0.5, got {extent:.3g}")
    if np.linalg.matrix_rank(vertices - vertices[0]) < 3:
        raise InvalidObject(f"{name}: expected a body with a volume, got none")
    hull = trimesh.convex.convex_hull(vertices, qhull_options="Qt")
    return np.asarray(hull.vertices), np.asarray(hull.faces)
