"""Kernels compiled, or loaded, ahead of their first use, by solving small problems through the functions users call."""

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.contact import (
    Contacts,
    Sphere,
    TactileSurface,
    contact_from_wrench,
    contacts_from_wrenches,
)
from handsight.correction import PosePrior, SkinEvidence, correct_pose
from handsight.forces.friction import Friction
from handsight.hand import Hand
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import Finger, Rig, Table
from handsight.tracking.follower import Follower
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.settings import TrackerSettings
from handsight.vision import DepthTracker, HandAppearance, detect_palm, locate, locate_all

EDGES = np.array([0.06, 0.09, 0.14])
"""Of the box to which all problems belong [m]."""
CAN = np.array([0.035, 0.1])
"""Radius and height of the can that is scanned: a larger one is so even that its noise is not measured [m]."""
SIGMA = 1e-3
"""Of all that is measured [m]."""
TIP = Sphere(0.01)
OUTSIDE = np.array([[0.1, 0, 0], [0, 0, 0]])
"""Points on a hand, one of them inside the box [m]."""


@cache
def warm_tracker() -> None:
    """Compiles or loads what a tracker calls, once in a process, so that its first answer is not late.

    Loading takes half a second, compiling a minute.
    """
    for solve in (correct_near, correct_far, sense, track):
        solve()


def correct_near() -> None:
    """Corrects a box from a near pose."""
    model, contacts = _touched_box()
    near = PosePrior(np.eye(4), np.eye(6) / 1000)
    correct_pose(model, contacts, vision=near)
    correct_pose(model, contacts, vision=near, outside=OUTSIDE)
    points, normals = contacts.points_palm, contacts.normals_palm
    shared = Contacts(points, normals, group=[0, 0, -1], shared_covariance=SIGMA**2 * np.eye(6))
    correct_pose(model, shared, vision=near)


def correct_far() -> None:
    """Corrects a box from a pose that is far off, with points of the hand, skin, and without a pose."""
    model, contacts = _touched_box()
    far = PosePrior(np.eye(4), np.eye(6))
    correct_pose(model, contacts, vision=far, outside=OUTSIDE)
    correct_pose(model, contacts, vision=far, skin=SkinEvidence(None, OUTSIDE, np.zeros(6)))
    correct_pose(model, contacts)


def build() -> None:
    """Builds the models of a box from its triangles and from points on it, and of a can from a scan."""
    box = ObjectModel.box(_new(EDGES))
    mesh = ObjectModel.from_mesh(box.vertices, box.faces)
    mesh.evaluate(mesh.points_object)
    ObjectModel.from_points(*mesh.sample(2000))
    radius, height = _new(CAN)
    points, normals = ObjectModel.cylinder(radius, height).sample(4000)
    # Noise that neighbours share, as depth images that were fused into one surface have it.
    waves = np.random.default_rng(0).normal(size=(3, 400)) / (3 * SIGMA)
    heights = SIGMA / 15 * np.cos(points @ waves + np.arange(400)).sum(axis=1)
    ObjectModel.from_points(points + heights[:, None] * normals)


def sense() -> None:
    """Senses a contact, alone and in a batch."""
    contact_from_wrench([0, 0, -1], [0, 0, 0], TIP)
    _ = contacts_from_wrenches([[0, 0, -1]], [[0, 0, 0]], TIP).covariances


def track() -> None:
    """Tracks a box in a hand of three fingers, by touch, one of them by taxels, and by poses that vision measured."""
    hand = _hand()
    if hand is None:
        return
    fingers = {name: Finger(frame=name, T_frame_surface=np.eye(4), tip=TIP) for name in hand.tips}
    taxels = TactileSurface.grid(
        frame="left", T_frame_grid=np.eye(4), rows=2, columns=2, pitch=SIGMA, threshold=0.5
    )
    rig = Rig(hand=hand, fingers=fingers, table=Table(height=0), skin={"left": taxels})
    model, contacts = _touched_box()
    follower = Follower(rig, model, TrackerSettings())
    offsets = JointOffsets.of(rig)
    offsets.after(
        model, contacts, np.zeros((3, 6, len(hand.moving))), np.eye(4), PosePrior(np.eye(4), np.eye(6))
    )
    state = follower.initial(None, offsets)
    joints = dict.fromkeys(hand.moving, 0.0)
    wrenches = dict.fromkeys(fingers, np.array([0, 0, -1.0, 0, 0, 0]))
    measured = PoseMeasurement(np.eye(4), "world")
    readings = {"left": np.full((2, 2), 9)}
    for stamp, vision in enumerate((measured, measured, None)):
        observation = Observation(stamp / 10, joints, wrenches, vision, np.eye(4), skin=readings)
        state, _ = follower.step(state, observation)
    Friction().update([0.5], kept_up=0.5)


def find_object() -> None:
    """Finds a box in a depth image, follows it, and grows a surface from two images."""
    from handsight.vision.reconstruction.reconstruct import Reconstruction, View  # loads more of SciPy

    model = ObjectModel.box(_new(EDGES))
    camera = _camera(96, 72)
    T = se3.compose(se3.rotation_exp(np.array([0.5, 0.5, 0])), np.array([0, 0, 0.5]))
    depth = _drawn(camera, se3.apply(T, model.vertices), model.faces)
    locate(model, depth, camera)
    locate_all({"box": model}, depth, camera)
    DepthTracker(model, camera, start=T).update(0.0, depth, hand=depth < 0, table=np.array([0, 0, -1, 1.0]))
    surface = Reconstruction(camera, model.bounds_object)
    surface.grow(View(depth, T))
    surface.grow(View(depth, T))


def find_hand() -> None:
    """Finds the palm of a hand in a depth image."""
    hand = _hand()
    if hand is None:
        return
    shape = hand.shape()
    camera = _camera(160, 120)
    joints = dict.fromkeys(hand.moving, 0.0)
    T = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0.5], [0, 0, 0, 1]])
    depth = _drawn(camera, se3.apply(T, shape.vertices_palm(joints)), shape.faces)
    placed = HandAppearance.of(hand).placed(joints)
    detect_palm(camera, depth, placed, T, sigma_position=SIGMA, sigma_rotation=SIGMA)


GROUPS: dict[str, Callable[[], None]] = {
    "corrections from a near pose": correct_near,
    "corrections from many starts": correct_far,
    "objects": build,
    "contact sensing": sense,
    "hands and tracking": track,
    "objects in images": find_object,
    "hands in images": find_hand,
}
"""Groups of kernels by what they are for, each with problems that need them."""

LATER = ("corrections from many starts", "hands and tracking")
"""Those that need kernels of the others too, and find them on disk if these come first."""


def _touched_box() -> tuple[ObjectModel, Contacts]:
    """Returns a box and contacts on three of its sides."""
    model = ObjectModel.box(EDGES)
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]])
    return model, Contacts(normals * EDGES / 2, normals, sigma_point=SIGMA, sigma_normal=SIGMA)


def _new(lengths: Array) -> Array:
    """Returns an object's lengths, by a new factor: what is known of earlier objects is read from disk."""
    return lengths * np.random.default_rng().uniform(0.9, 1)


def _hand() -> Hand | None:
    """Returns a hand of three fingers; None without MuJoCo, where no hand can be read."""
    if find_spec("mujoco") is None:
        return None
    file = Path(__file__).parents[1] / "data/three_fingers.xml"
    return Hand.from_file(file, palm="palm", tips={name: name for name in ("left", "right", "back")})


def _camera(width: int, height: int) -> Camera:
    """Returns a camera with images of that size [pixels]."""
    return Camera(np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]]), (width, height))


def _drawn(camera: Camera, vertices: Array, faces: Indices) -> Depth:
    """Returns a depth image of triangles before a wall."""
    depth = camera.draw(vertices, faces).depth
    return np.where(np.isfinite(depth), depth, np.float32(1.0))
