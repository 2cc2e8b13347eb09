"""From a six-axis sensor under a fingertip to a contact: calibrate, subtract bias and tip weight, sense."""

import numpy as np

import _picture
import handsight as hs
from handsight import se3

tip = hs.Ellipsoid(semi_axes=(0.008, 0.008, 0.012), cap=0.0, max_friction=1.0)

# Readings of the free tip in six orientations (made up here; yours come from the sensor), sensor frame.
rng = np.random.default_rng(0)
gravities = np.array([9.81 * R[2] for R in se3.random(rng, 6)[:, :3, :3]])
mass, center, bias = 0.02, np.array([0, 0, 0.01]), np.array([0.3, -0.1, 0.2])
forces = bias + mass * gravities + 0.005 * rng.normal(size=(6, 3))
torques = np.cross(center, mass * gravities) + 2e-5 * rng.normal(size=(6, 3))
calibration = hs.calibrate_wrench(forces, torques, gravities)
print(f"mass {1e3 * calibration.mass:.1f} g, bias {np.round(calibration.bias_force, 3)} N")

# The same sensor's reading of a push of 2 N on the tip's side.
push, where = np.array([-2.0, 0, -0.3]), np.array([0.0066, 0, 0.0068])
read_force = bias + mass * gravities[0] + push
read_torque = np.cross(center, mass * gravities[0]) + np.cross(where, push)
force, torque = hs.contact.compensate(read_force, read_torque, gravities[0], calibration)

contact = hs.contact_from_wrench(force, torque, tip)
if contact:
    print("point [mm]:", np.round(1e3 * contact.point, 2), " normal:", np.round(contact.normal, 2))
    print(f"normal force {contact.force_normal:.2f} N")
    around, along = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 0.5 * np.pi, 20))
    cap = [np.cos(around) * np.cos(along), np.sin(around) * np.cos(along), np.sin(along)]
    clouds = {"fingertip": np.reshape(cap, (3, -1)).T * tip.semi_axes}
    _picture.bodies("A contact on a fingertip", None, {}, contact.point[None], contact.normal[None], clouds)
else:
    print("no contact:", contact.reason)
