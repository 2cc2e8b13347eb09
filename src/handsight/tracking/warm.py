"""Kernels compiled, or loaded, ahead of their first use, by solving small problems through the functions users call."""

from collections.abc import Callable
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.contact import (
    Contacts,
    Gel,
    Sphere,
    TactileSurface,
    WrenchCalibration,
    contact_from_wrench,
    contacts_from_wrenches,
)
from handsight.correction import PosePrior, SkinEvidence, TwoPhase, correct_pose
from handsight.forces.friction import Friction
from handsight.hand import Hand
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import Finger, Rig, Table
from handsight.tracking.follower import Follower
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.settings import TrackerSettings
from handsight.vision import DepthTracker, HandAppearance, detect_palm, locate, locate_all


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
    near = PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)
    correct_pose(model, contacts, vision=near)
    points, normals = contacts.points_palm, contacts.normals_palm
    shared = Contacts(points, normals, group=[0, 0, -1], shared_covariance=1e-6 * np.eye(6))
    correct_pose(model, shared, vision=near)


def correct_far() -> None:
    """Corrects a box from a pose that is far off, with points of the hand, skin, by sampling, and without a pose."""
    model, contacts = _touched_box()
    far = PosePrior.from_sigmas(np.eye(4), 0.1, 0.5)
    correct_pose(model, contacts, vision=far, outside=[[0.1, 0, 0], [0.05, 0.05, 0]])
    correct_pose(model, contacts, vision=far, skin=SkinEvidence(None, np.array([[0.1, 0, 0]]), np.zeros(6)))
    correct_pose(model, contacts, vision=far, samples=200)
    correct_pose(model, contacts)
    correct_pose(model, contacts, vision=far, method=TwoPhase(starts=1000, reject_outliers=False))


def build() -> None:
    """Builds the models of a box from its triangles and from points on it, and of a can from a scan."""
    box = _new_box()
    mesh = ObjectModel.from_mesh(box.vertices, box.faces)
    mesh.evaluate(mesh.points_object)
    ObjectModel.from_points(*mesh.sample(2000))
    points, normals = ObjectModel.cylinder(0.035 * _near_one(), 0.1).sample(4000)
    # Noise that neighbours share, as depth images that were fused into one surface have it.
    rng = np.random.default_rng(0)
    waves, phases = rng.normal(size=(3, 400)) / 3e-3, rng.uniform(0, 2 * np.pi, 400)
    heights = 8e-4 / np.sqrt(200) * np.cos(points @ waves + phases).sum(axis=1)
    ObjectModel.from_points(points + heights[:, None] * normals)


def sense() -> None:
    """Senses a contact, alone and in a batch."""
    tip = Sphere(0.01)
    contact_from_wrench([0, 0, -1], [0, 0, 0], tip)
    _ = contacts_from_wrenches([[0, 0, -1]], [[0, 0, 0]], tip).covariances


def track() -> None:
    """Tracks a box in a hand of three fingers, by touch, one of them by taxels, and by poses that vision measured."""
    hand = _hand()
    if hand is None:
        return
    inward = {"left": [0, np.pi / 2, 0], "right": [0, -np.pi / 2, 0], "back": [np.pi / 2, 0, 0]}
    zero = np.zeros(3)
    calibration = WrenchCalibration(zero, zero, 0.0, zero, zero, zero, condition=1.0)
    poses = {name: se3.compose(se3.rotation_exp(np.array(turn)), zero) for name, turn in inward.items()}
    tip = partial(Finger, tip=Sphere(0.01), calibration=calibration)
    fingers = {name: tip(frame=name, T_frame_surface=T) for name, T in poses.items()}
    T_frame_grid = fingers["left"].T_frame_surface @ se3.compose(np.eye(3), np.array([0, 0, 0.01]))
    grid: dict[str, Any] = {"T_frame_grid": T_frame_grid, "pitch": 1e-3, "threshold": 0.1}
    taxels = TactileSurface.grid(frame="left", rows=2, columns=2, **grid)
    Gel.grid(frame="left", rows=3, columns=3, **grid).touch(np.ones((3, 3)))
    rig = Rig(hand=hand, fingers=fingers, table=Table(height=-0.2), skin={"left": taxels})
    follower, joints = Follower(rig, _touched_box()[0], TrackerSettings()), dict.fromkeys(hand.moving, 0.0)
    state = follower.initial(None, JointOffsets.of(rig))
    wrenches = dict.fromkeys(fingers, np.array([0, 0, -1.0, 0, 0, 0]))
    measured = PoseMeasurement(np.eye(4), "world")
    for stamp, vision in ((0.0, measured), (0.1, measured), (0.2, None)):
        observation = Observation(stamp, joints, wrenches, vision, np.eye(4), skin={"left": np.ones((2, 2))})
        state, _ = follower.step(state, observation)
    follower.joint_offsets(state)
    Friction().update([(0.5, 1)], kept_up=0.5)


def find_object() -> None:
    """Finds a box in a depth image, follows it, and grows a surface from two images."""
    from handsight.vision.reconstruction.reconstruct import Reconstruction, View  # loads more of SciPy

    model, camera = _new_box(), _camera(96, 72)
    T = se3.compose(se3.rotation_exp(np.array([0.5, 0.4, 0])), np.array([0, 0, 0.3]))
    depth = _drawn(camera, se3.apply(T, model.vertices), model.faces)
    locate(model, depth, camera)
    locate_all({"box": model}, depth, camera)
    DepthTracker(model, camera, start=T).update(0.0, depth, hand=depth < 0, table=np.array([0, 0, -1, 0.6]))
    surface = Reconstruction(camera, np.array([[-0.1] * 3, [0.1] * 3]))
    surface.grow(View(depth, T))
    surface.grow(View(depth, T))


def find_hand() -> None:
    """Finds the palm of a hand in a depth image."""
    hand = _hand()
    if hand is None:
        return
    shape, camera, joints = hand.shape(), _camera(160, 120), dict.fromkeys(hand.moving, 0.0)
    T = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0.35], [0, 0, 0, 1]])
    depth = _drawn(camera, se3.apply(T, shape.vertices_palm(joints)), shape.faces)
    placed = HandAppearance.of(hand).placed(joints)
    detect_palm(camera, depth, placed, T, sigma_position=0.01, sigma_rotation=0.05)


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
    """Returns a box and three contacts on it."""
    points = [[0.03, 0, 0.02], [-0.03, 0.01, 0], [0, 0.045, 0.01]]
    normals = [[1, 0, 0], [-1, 0, 0], [0, 1, 0]]
    return ObjectModel.box((0.06, 0.09, 0.14)), Contacts(points, normals, sigma_point=5e-4, sigma_normal=0.03)


def _new_box() -> ObjectModel:
    return ObjectModel.box(np.array([0.06, 0.09, 0.14]) * _near_one())


def _near_one() -> float:
    """Returns a factor by which an object is a new one; what is known of earlier ones is read from disk."""
    return float(np.random.default_rng().uniform(0.98, 1.02))


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
    return np.where(np.isfinite(depth), depth, np.float32(0.6))
