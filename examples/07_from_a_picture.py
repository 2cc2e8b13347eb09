"""One depth image without a guess: the hand is masked, the can is found, and three fingertips correct its pose."""

import json
from importlib.resources import files

import numpy as np

import _picture
import handsight as hs
from handsight import se3
from handsight.vision import hand_mask, locate, read_camera, read_depth

# The picture comes with the package (rendered, with a camera's errors); yours is a PNG in millimetres and camera.json.
data = files("handsight") / "data"
known = json.loads((data / "can.picture.json").read_text())
camera = read_camera(data / "can.camera.json")
depth = read_depth(data / "can.depth.png", camera=camera)
try:
    rig = hs.Rig.from_file(data / "can.rig.yaml")
except hs.HandsightError as error:
    raise SystemExit(print(f"skipped, the Shadow hand's files are missing: {error}")) from None
model = rig.objects["can"].model()

# Pixels of the hand are masked, for they cannot be the object.
T_camera_palm = se3.from_position_quaternion(**known["T_camera_palm"])
shape = rig.hand.shape()
vertices_palm = shape.vertices_palm(known["joint_positions"])
hand = hand_mask(camera, np.nan_to_num(depth), vertices_palm, shape.faces, T_camera_palm)
found = locate(model, depth, camera, hand=hand)
print(f"found with probability {found.probability:.2f}, in {len(found.weights)} poses")

# In the palm's frame it is the prior of a correction.
T_palm_camera = se3.inverse(T_camera_palm)
T_palm_vision = T_palm_camera @ found.Ts_camera_object[0]
vision = hs.PosePrior(T_palm_vision, se3.rotate_covariance(T_palm_camera[:3, :3], found.covariances[0]))

# Three contacts on the can at its true pose (made up here; yours come from the fingertips).
T_palm_true = T_palm_camera @ se3.from_position_quaternion(**known["truth"])
angles = np.deg2rad([0, 130, 250])
normals_can = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
points_can = 0.033 * normals_can + [[0, 0, 0.02], [0, 0, -0.03], [0, 0, 0.01]]
contacts = hs.Contacts(
    points_can @ T_palm_true[:3, :3].T + T_palm_true[:3, 3],
    normals_can @ T_palm_true[:3, :3].T,
    sigma_point=1e-3,
    sigma_normal=0.1,
)
estimate = hs.correct_pose(model, contacts, vision=vision)


def axis_off(T_palm_object: np.ndarray) -> float:
    """Returns the distance of the can's axis from the true middle [mm]."""
    away, axis = T_palm_true[:3, 3] - T_palm_object[:3, 3], T_palm_object[:3, 2]
    return 1e3 * float(np.linalg.norm(away - axis * (away @ axis)))


print(
    f"axis off by {axis_off(T_palm_vision):.1f} mm by vision, {axis_off(estimate.T_palm_object):.1f} mm with touch"
)
if (plt := _picture.pyplot()) is not None:
    axes = plt.subplots(figsize=(8, 6), layout="constrained")[1]
    axes.imshow(np.where(depth > 0, depth, np.nan), cmap="Greys_r")
    axes.imshow(np.where(hand, 1.0, np.nan), cmap="cool", alpha=0.3)
    surface = model.sample(400)[0]
    for label, T_palm_can, color in (
        ("vision", T_palm_vision, "cyan"),
        ("with touch", estimate.T_palm_object, "orange"),
    ):
        pixels = camera.project(se3.apply(T_camera_palm @ T_palm_can, surface))
        axes.plot(*pixels.T, ".", color=color, markersize=2, label=label)
    axes.set(title="The can in the depth image; the hand is tinted", xticks=[], yticks=[])
    axes.legend(markerscale=5)
    _picture.save(plt)
