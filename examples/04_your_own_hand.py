"""An Allegro hand, described by a rig file of the package, closes on a can; its readings are recorded and tracked.

Its URDF must be in $ROS_PACKAGE_PATH. The recording goes into the folder given as argument, else a temporary one.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import _picture
import handsight as hs
from handsight import se3
from handsight.observation import PoseMeasurement
from handsight.recording import RecordingWriter, open_recording

try:
    rig = hs.Rig.from_file(Path(hs.__file__).parent / "data" / "rigs" / "allegro.rig.yaml")
except hs.HandsightError as error:
    sys.exit(print(f"skipped, the hand's URDF is missing: {error}"))

# The can's true pose, across the palm. Each finger closes until its tip's middle is 33 + 12 mm from the can's axis.
T_palm_can = se3.from_position_quaternion([0.07, 0, 0], [-(0.5**0.5), 0, 0, 0.5**0.5])
joints, fingers = dict.fromkeys(rig.hand.joint_names, 0.0) | {"joint_12.0": 1.396}, list(rig.fingers)


def tip(closed: float, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the pose of the k-th tip's middle in the palm, and the vector to it from the can's axis [m]."""
    bent = {f"joint_{4 * k + j}.0": closed for j in (1, 2, 3)}
    T_palm_tip = rig.hand.Ts_palm_tip(joints | bent)[k] @ rig.fingers[fingers[k]].T_frame_surface
    return T_palm_tip, (T_palm_tip[:3, 3] - T_palm_can[:3, 3]) * [1, 0, 1]


readings = []  # each sensor's wrench with the tip's weight alone, and with a push of 2 N by the can
for k, finger in enumerate(rig.fingers.values()):
    closed = brentq(lambda closed, k: np.linalg.norm(tip(closed, k)[1]) - 0.045, 0.2, 0.9, args=(k,))
    T_palm_tip, out = tip(closed, k)
    T_palm_sensor, normal = T_palm_tip @ finger.tip.T_surface_sensor, out / np.linalg.norm(out)
    lever = T_palm_tip[:3, 3] - finger.tip.radius * normal - T_palm_sensor[:3, 3]
    push = np.stack([2 * normal, np.cross(lever, 2 * normal)]) @ T_palm_sensor[:3, :3]
    weight = finger.calibration.mass * rig.gravity @ T_palm_sensor[:3, :3]
    still = np.stack([weight, np.cross(finger.calibration.center_of_mass, weight)])
    readings.append((still.ravel(), (still + push).ravel()))
    joints |= {f"joint_{4 * k + j}.0": closed for j in (1, 2, 3)}

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
T_palm_vision = T_palm_can.copy()
T_palm_vision[:3, 3] += [0.02, 0.015, -0.01]  # vision is 27 mm off
with RecordingWriter(folder / "allegro.mcap", rig) as writer:
    for k in range(50):
        wrenches = {finger: readings[i][k >= 25] for i, finger in enumerate(fingers)}
        vision = PoseMeasurement(T_palm_vision, "palm") if k % 10 == 0 else None
        writer.write(hs.Observation(100 + 0.02 * k, joints, wrenches, vision, np.eye(4)))
tracker = hs.Tracker(rig, rig.objects["can"].model())
with open_recording(folder / "allegro.mcap", rig) as recording:
    estimates = [tracker.update(observation) for observation in recording.observations()]
errors = [1e3 * np.linalg.norm((each.T_palm_object - T_palm_can)[[0, 2], 3]) for each in estimates]
print(f"{tracker.state}: {errors[0]:.1f} mm off the can's axis by vision, {errors[-1]:.1f} mm with touch")

found = tracker.fingertips.contacts
poses = {"vision": T_palm_vision, "tracked": estimates[-1].T_palm_object}
links = {"links": rig.hand.shape().vertices_palm(joints)[::5]}
model = rig.objects["can"].model()
_picture.bodies("An Allegro hand on a can", model, poses, found.points_palm, found.normals_palm, links)
