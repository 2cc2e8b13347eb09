"""Five fingertip contacts correct vision that is 8 cm off: prior and contacts in, pose and covariance out."""

import numpy as np

import _picture
import handsight as hs

model = hs.ObjectModel.box((0.06, 0.09, 0.14))

# Contact points in the palm's frame [m], and the object's outward normals there.
contacts = hs.Contacts(
    points_palm=[[0.03, 0.01, 0.13], [0.03, -0.02, 0.06], [-0.01, 0.045, 0.12], [0.01, -0.045, 0.09], [0, 0.02, 0.17]],
    normals_palm=[[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]],
    sigma_point=1e-3,
    sigma_normal=np.deg2rad(5),
)  # fmt: skip

# Vision's pose of the object, with one standard deviation per axis [m, rad].
T_palm_vision = np.eye(4)
T_palm_vision[:3, 3] = [0.05, -0.04, 0.15]
vision = hs.PosePrior.from_sigmas(T_palm_vision, sigma_position=0.05, sigma_rotation=np.deg2rad(15))

estimate = hs.correct_pose(model, contacts, vision=vision)
print("position [mm]:", np.round(1e3 * estimate.T_palm_object[:3, 3], 1))
print("sigma [mm]:   ", np.round(1e3 * np.sqrt(np.diagonal(estimate.covariance))[:3], 2))
print("consistent:", estimate.consistent, " outliers:", estimate.outliers)
print("unobservable directions:", len(estimate.unobservable))

poses = {"vision": T_palm_vision, "corrected": estimate.T_palm_object}
_picture.bodies("One correction, in the palm", model, poses, contacts.points_palm, contacts.normals_palm)
