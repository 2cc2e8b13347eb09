"""Without a camera: several poses of a can fit three contacts, and each comes with its probability."""

import numpy as np

import _picture
import handsight as hs

model = hs.ObjectModel.cylinder(radius=0.033, height=0.115)
angle = np.deg2rad([0.0, 120.0, 240.0])
normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)
points = 0.033 * normals + np.array([[0, 0, 0.02], [0, 0, -0.02], [0, 0, 0.01]])
contacts = hs.Contacts(points, normals, sigma_point=1e-3, sigma_normal=0.1)

estimate = hs.correct_pose(model, contacts)
for mode in estimate.hypotheses:
    middle, axis = 1e3 * mode.T_palm_object[:3, 3], mode.T_palm_object[:3, 2]
    print(f"probability {mode.weight:.2f}: middle at {np.round(middle)} mm, axis {np.round(axis, 2)}")
print(f"{len(estimate.unobservable)} unobservable directions: the can may slide and spin between the fingers")

poses = {f"probability {mode.weight:.2f}": mode.T_palm_object for mode in estimate.hypotheses}
_picture.bodies("Poses that fit three contacts", model, poses, points, normals)
