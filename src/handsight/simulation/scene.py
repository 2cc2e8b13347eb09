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
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject, MissingExtra, needing
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.simulation.hand_in_world import HandInWorld, TipInWorld, hand_of
from handsight.simulation.scenario import SCENARIO

if TYPE_CHECKING:
    from mujoco import MjSpec


HAND_FILE = "envs/assets/hand/reach.xml"  # within gymnasium-robotics; its only scene without an object
PALM = "robot0:palm"
PALM_GEOM = "robot0:C_palm0"  # the geom that a tactile array of the palm covers
T_MOUNT_PALM = se3.compose(np.eye(3), np.array([0.0, 0.01, 0.29]))
"""(4, 4) of the palm in the hand's mount, with the wrist straight."""
FINGERS = ("ff", "mf", "rf", "lf", "th")
TipErrors = tuple[tuple[float, float], ...]


class SceneOptions(NamedTuple):
    """`SceneOptions` are sizes in the simulated scene."""

    sensor_z: float = 0.002  # of a sensor's frame along its distal link [m]
    tip_mass: float = 0.004  # of a tip [kg]
    focal_length: float = 525.0  # of the camera's images, as a Kinect's [pixels]
    supersampling: int = 2  # factor by which a picture for people is drawn larger, each way, and averaged
    table_collision_bit: int = 2
    """Collision bit of object and fingertips: nothing else collides with the table. A random draw may lower the palm's
    edge some millimetres into the table, where a collision would bend the wrist."""
    hidden_group: int = 5  # group of the geoms that are not drawn


SCENE = SceneOptions()

GRAVITY = np.array([0.0, 0.0, -9.81])
UNLOADED = np.array([
    [0.21, -0.34, 0.12, 0.0021, -0.0013, 0.0008],
    [-0.15, 0.08, 0.43, -0.0009, 0.0017, -0.0011],
    [0.32, 0.17, -0.26, 0.0014, 0.0006, 0.0019],
    [-0.28, 0.24, 0.19, -0.0018, -0.0022, 0.0005],
    [0.09, -0.19, -0.37, 0.0007, 0.0012, -0.0016],
])  # fmt: skip
"""(5, 6) readings of the fingers' sensors without load [N, N m]; the rig's calibration has the same."""
CAN_SIZE, BOX_SIZE = (0.033, 0.122), (0.060, 0.090, 0.140)  # radius, height of the can; sides of the box [m]
TABLE = ((-0.075, 0.6), (-0.45, 0.45), (-0.03, 0.0))  # first and last coordinate along x, y, z [m]
IMAGE_SIZE = (640, 480)  # width and height of the camera's images, a Kinect's [pixels]


def stiffness(softness: float) -> dict[str, list[float]]:
    """Returns the contact stiffness, for `contact_softness`. With MuJoCo's defaults tips sink in by 0.5 mm, which moves
    sensed points by 0.2 mm; with contacts much stiffer than the usual ones the hand drops objects."""
    k = 1 + softness
    return {"solref": [0.01 * k, 1.0], "solimp": [1 - 0.05 * k, 1 - 0.01 * k, 0.001, 0.5, 2.0]}


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScene:
    """A `SimulatedScene` is a compiled scene, the same for all draws of one object. Its bodies are PALM, `object`, and
    one that ends in `_tip` for each finger."""

    model: Any  # mujoco.MjModel, never changed after this
    joints: dict[str, int]  # places of the hand's joints in qpos, by name
    tips: dict[int, str]  # names of fingers by their tip's geom
    bounds_object: Array  # (2, 3) in the object's frame [m]
    hand: HandInWorld


def tip_shape(finger: str) -> tuple[Array, float]:
    """Returns the semi-axes (3,) of a fingertip and its centre's z from the sensor's frame [m]."""
    if finger == "th":
        return np.array([0.0105, 0.0105, 0.016]), 0.0175 - SCENE.sensor_z
    return np.array([0.009, 0.009, 0.0145]), 0.0165 - SCENE.sensor_z


def mujoco_module() -> ModuleType:
    """Returns mujoco; raises MissingExtra."""
    with needing("simulation needs mujoco", "sim"):
        return import_module("mujoco")


@lru_cache(maxsize=8)
def scene(
    name: str,
    mass: float = SCENARIO.object_mass,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    friction: float = 1.0,
    pyramidal: bool = False,
    softness: float = 0.0,
    tip_errors: TipErrors = (),
    rig: Rig | None = None,
) -> SimulatedScene:
    """Returns the scene with an object: `name` is `can`, `box`, a mesh file or in the library; and the hand of a
    rig, or the Shadow hand.

    The object has that mass [kg], its centre of mass is displaced by `shift` [m]; `friction` and `tip_errors`, of
    radius and length [m], are the tips'. Raises MissingExtra without mujoco or gymnasium-robotics, InvalidFile or
    InvalidObject for a mesh that cannot be used.
    """
    mujoco = mujoco_module()
    spec, hand = _shadow_hand(mujoco) if rig is None else hand_of(rig)
    spec.option.gravity = GRAVITY
    spec.option.timestep = 1 / SCENARIO.steps_per_second
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.iterations, spec.option.tolerance = 100, 1e-10
    cones = mujoco.mjtCone
    spec.option.cone = cones.mjCONE_PYRAMIDAL if pyramidal else cones.mjCONE_ELLIPTIC
    spec.option.impratio = 50.0 if pyramidal else 10.0  # else a pyramid lets a held object creep
    _add_tips(mujoco, spec, hand, friction, softness, tip_errors or ((0.0, 0.0),) * len(hand.tips))
    _carry(mujoco, spec, hand)
    _add_table_and_camera(mujoco, spec)
    bounds = _add_object(mujoco, spec, name, softness)
    if mass != SCENARIO.object_mass or any(shift):
        # The inertia about the centre of mass is proportional to the mass.
        body, usual = spec.body("object"), scene(name, rig=rig).model.body("object")
        body.explicitinertial, body.mass = True, mass
        body.ipos, body.iquat = usual.ipos + shift, usual.iquat
        body.inertia = usual.inertia * (mass / usual.mass[0])
    model = spec.compile()
    return SimulatedScene(
        model=model,
        joints={name: int(model.joint(name).qposadr[0]) for name in hand.joints},
        tips={model.geom(f"{finger}_tip").id: finger for finger in hand.tips},
        bounds_object=bounds,
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
        spec.geom(f"robot0:V_{finger}distal").group = SCENE.hidden_group
        T_link_sensor = se3.compose(np.eye(3), np.array([0.0, 0.0, SCENE.sensor_z]))
        center = np.array([0.0, 0.0, center_z])
        link, placed = f"robot0:{finger}distal", (T_link_sensor, se3.compose(np.eye(3), center))
        tips[finger] = TipInWorld(link, *placed, semi_axes, SCENE.tip_mass, center, unloaded, 1.0)
    mount = spec.body("robot0:hand mount")
    mount.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # else its Euler angles override the quaternion
    # Tips that are no neighbours never meet.
    meeting = (("ff", "mf"), ("mf", "rf"), ("rf", "lf"), *((finger, "th") for finger in FINGERS[:4]))
    joints = tuple(joint.name for joint in spec.joints)
    return spec, HandInWorld(PALM, mount.name, T_MOUNT_PALM, tips, joints, meeting)


def _add_tips(
    mujoco: ModuleType, spec: "MjSpec", hand: HandInWorld, friction: float, softness: float, errors: TipErrors
) -> None:
    """Adds the ellipsoid of each fingertip on a sensor, which measures every force on it."""
    for (finger, of), (wider, longer) in zip(hand.tips.items(), errors, strict=True):
        tip = spec.body(of.link).add_body(name=f"{finger}_tip", **_placed(of.T_link_sensor))
        semi_axes = of.semi_axes + np.array([wider, wider, longer])
        tip.add_geom(
            name=f"{finger}_tip", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=semi_axes, mass=of.mass,
            contype=1 | SCENE.table_collision_bit, conaffinity=0, condim=4, **_placed(of.T_sensor_surface),
            friction=[friction, SCENARIO.torsion * friction, 0.0001],
            priority=1, margin=0.0, rgba=[0.25, 0.25, 0.28, 1],
            **stiffness(softness),
        )  # fmt: skip
        if not np.array_equal(of.center, of.T_sensor_surface[:3, 3]):
            tip.explicitinertial, tip.mass, tip.ipos = True, of.mass, of.center
            tip.inertia = of.mass * of.semi_axes.max() ** 2 * np.full(3, 0.4)
        tip.add_site(name=f"{finger}_ft")
        site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": f"{finger}_ft"}
        spec.add_sensor(name=f"{finger}_force", type=mujoco.mjtSensor.mjSENS_FORCE, **site)
        spec.add_sensor(name=f"{finger}_torque", type=mujoco.mjtSensor.mjSENS_TORQUE, **site)
    # The hand's geoms collide only in declared pairs.
    for a, b in hand.neighbours:
        spec.add_pair(geomname1=f"{a}_tip", geomname2=f"{b}_tip", condim=1)


def _placed(T: Array) -> dict[str, Array]:
    """Returns position and quaternion of a pose (4, 4), as MuJoCo takes them."""
    return {"pos": T[:3, 3], "quat": np.roll(se3.quaternion_from_rotation(T[:3, :3]), 1)}


def _carry(mujoco: ModuleType, spec: "MjSpec", hand: HandInWorld) -> None:
    """Lets the hand float, welded to a mocap body that represents the arm."""
    mount = spec.body(hand.mount)
    mount.pos, mount.quat = [0, 0, 0], [1, 0, 0, 0]
    mount.add_freejoint(name="mount")
    spec.worldbody.add_body(name="arm", mocap=True)
    data = np.zeros(mujoco.mjNEQDATA)
    data[6] = data[10] = 1.0  # the quaternion's w, and a torque scale of 1
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="arm", name2=hand.mount,
        data=data, solref=[0.004, 1.0], solimp=[0.99, 0.999, 0.001, 0.5, 2.0],
    )  # fmt: skip
    # As under a robot's controller, arm and hand are weightless; the tips' weight stays, for sensors measure it.
    for body in spec.bodies:
        if body.name.startswith(("robot0:", "hand/")):
            body.gravcomp = 1.0


def _add_table_and_camera(mujoco: ModuleType, spec: "MjSpec") -> None:
    """Adds table, camera and lights, and sets how they are drawn."""
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 0  # smoothing by the driver costs five times as much
    spec.visual.global_.offwidth = SCENE.supersampling * IMAGE_SIZE[0]
    spec.visual.global_.offheight = SCENE.supersampling * IMAGE_SIZE[1]
    spec.stat.extent = 1.0  # the unit of the near and the far plane
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 10.0
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="background", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[0.85, 0.87, 0.9], width=64, height=64,
    )  # fmt: skip
    low, high = np.array(TABLE).T
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, pos=(low + high) / 2, size=(high - low) / 2,
        contype=0, conaffinity=SCENE.table_collision_bit, friction=[0.4, 0.005, 0.0001], priority=1,
        rgba=[0.85, 0.76, 0.64, 1], **stiffness(0.0),
    )  # fmt: skip
    fovy = float(np.rad2deg(2 * np.arctan(IMAGE_SIZE[1] / 2 / SCENE.focal_length)))
    spec.worldbody.add_camera(name="camera", fovy=fovy)
    # All lights together are less than full, or white parts would lose their shape.
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.25] * 3, [0.15] * 3
    if spec.light("light0") is not None:  # of the Shadow hand's file
        spec.light("light0").ambient, spec.light("light0").diffuse = [0.0] * 3, [0.25] * 3
    spec.worldbody.add_light(
        pos=[-0.5, 0.6, 1.2], dir=[0.35, -0.45, -0.82], diffuse=[0.4] * 3, castshadow=True
    )


def _add_object(mujoco: ModuleType, spec: "MjSpec", name: str, softness: float) -> Array:
    """Adds the object and returns its bounds (2, 3) in its own frame [m]."""
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    geometry: dict[str, Any] = {"rgba": [0.75, 0.12, 0.12, 1]}
    if name == "can":
        radius, height = CAN_SIZE
        bounds = np.outer([-1.0, 1.0], [radius, radius, height / 2])
        geometry |= {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [radius, height / 2, 0]}
    elif name == "box":
        bounds = np.outer([-1.0, 1.0], np.array(BOX_SIZE) / 2)
        geometry |= {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": np.array(BOX_SIZE) / 2}
        geometry |= {"rgba": [0.15, 0.45, 0.2, 1]}
    else:
        vertices, faces = convex_hull(name)
        bounds = np.asarray([vertices.min(axis=0), vertices.max(axis=0)])
        spec.add_mesh(name="object", uservert=vertices.ravel(), userface=faces.ravel())
        geometry |= {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "object"}
    body.add_geom(
        name="object", mass=SCENARIO.object_mass, condim=4, friction=[1.0, 0.005, 0.0001],
        contype=1 | SCENE.table_collision_bit, conaffinity=1, **geometry, **stiffness(softness),
    )  # fmt: skip
    return np.asarray(bounds)


@lru_cache(maxsize=8)
def convex_hull(path: str) -> tuple[Array, Any]:
    """Returns vertices (k, 3) [m] and faces (m, 3) of an object's convex hull; `path` as `scene` takes `name`."""
    import trimesh

    if path in ("can", "box"):
        creation = trimesh.creation
        mesh = creation.box(BOX_SIZE) if path == "box" else creation.cylinder(*CAN_SIZE, sections=64)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)

    from handsight.objects.files import read_shape

    shape = read_shape(path) if Path(path).suffix else ObjectModel.from_library(path)
    vertices, name, most = shape.vertices, Path(path).name, SCENARIO.max_extent
    extent = float(np.ptp(vertices, axis=0).max())
    if not extent <= most:
        raise InvalidObject(f"{name}: expected metres, at most {most:g}, got {extent:.3g}")
    if np.linalg.matrix_rank(vertices - vertices[0]) < 3:
        raise InvalidObject(f"{name}: expected a body with a volume, got none")
    hull = trimesh.convex.convex_hull(vertices, qhull_options="Qt")
    return np.asarray(hull.vertices), np.asarray(hull.faces)
