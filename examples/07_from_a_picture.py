"""One depth image, no guess: the hand is taken out of it, the can is found, and three fingertips put it in place."""

import json
from importlib.resources import files

import numpy as np

import handsight as hs
from handsight import se3
from handsight.vision import hand_mask, locate, read_camera, read_depth

# The picture comes with the package (drawn, with a camera's errors): yours are a PNG of millimetres and camera.json.
data = files("handsight") / "data"
known = json.loads((data / "can.picture.json").read_text())
camera = read_camera(data / "can.camera.json")
depth = read_depth(data / "can.depth.png", camera=camera)
try:
    rig = hs.Rig.from_file(data / "can.rig.yaml")
except hs.HandsightError as error:
    raise SystemExit(print(f"skipped, there is no Shadow hand here: {error}")) from None
model = rig.objects["can"].model()

# What is the hand's in the picture is no object.
T_camera_palm = se3.from_position_quaternion(**known["T_camera_palm"])
shape = rig.hand.shape()
vertices_palm = shape.vertices_palm(known["joint_positions"])
hand = hand_mask(camera, np.nan_to_num(depth), vertices_palm, shape.faces, T_camera_palm)
found = locate(model, camera, depth, hand=hand)
print(f"found with probability {found.probability:.2f}, {len(found.weights)} poses")

# In the palm it is what a correction begins with.
T_palm_camera = se3.inverse(T_camera_palm)
T_palm_seen = T_palm_camera @ found.Ts_camera_object[0]
vision = hs.PosePrior(T_palm_seen, se3.rotate_covariance(T_palm_camera[:3, :3], found.covariances[0]))

# Three contacts on the can where it is in truth (here made up; yours come from the fingertips).
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
    """How far the can's axis passes from the true middle [mm]."""
    away, axis = T_palm_true[:3, 3] - T_palm_object[:3, 3], T_palm_object[:3, 2]
    return 1e3 * float(np.linalg.norm(away - axis * (away @ axis)))


print(
    f"axis off by {axis_off(T_palm_seen):.1f} mm as seen, {axis_off(estimate.T_palm_object):.1f} mm with touch"
)
