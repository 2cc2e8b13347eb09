"""Taxels: what is pressed is contact, and where nothing is pressed the object does not reach, which ends its slide."""

import numpy as np

import _picture
import handsight as hs
from handsight.contact import TactileSurface

# An array of 20 x 15 taxels in the palm. A box covers its columns from the eighth on.
array = TactileSurface.grid(
    frame="palm", T_frame_grid=np.eye(4), rows=20, columns=15, pitch=0.004, threshold=0.02
)
reading = np.zeros(array.shape)  # the robot's reading, above what it reads untouched
reading[:, 7:] = 0.1
touch = array.touch(reading)

model = hs.ObjectModel.box((0.09, 0.14, 0.06))
tips = hs.Contacts([[0.03, 0.01, 0.06], [0.04, -0.02, 0.06]], [[0, 0, 1], [0, 0, 1]], sigma_point=1e-3)
T_palm_vision = np.eye(4)
T_palm_vision[:3, 3] = [0.06, 0, 0.02]
vision = hs.PosePrior.from_sigmas(T_palm_vision, sigma_position=0.02, sigma_rotation=0.1)

for name, skin in (("tips", None), ("tips and taxels", hs.SkinEvidence.of(touch, np.eye(4)))):
    estimate = hs.correct_pose(model, tips, vision=vision, skin=skin)
    edge = 1e3 * (estimate.T_palm_object[0, 3] - 0.045)
    print(f"{name}: the box begins at x = {edge:.0f} mm (true: between -4 and 0)")

x, y = 0.004 * (np.arange(15) - 7), 0.004 * (np.arange(20) - 9.5)
places = np.stack([*np.meshgrid(x, y), np.zeros((20, 15))], axis=-1)
clouds = {"pressed taxels": places[touch.pressed], "untouched taxels": places[touch.untouched]}
poses = {"vision": T_palm_vision, "corrected": estimate.T_palm_object}
_picture.bodies("Taxels end a slide", model, poses, tips.points_palm, tips.normals_palm, clouds)
