"""In a control loop: joints, raw wrenches and occasional poses from vision go in; pose and uncertainty come out."""

import numpy as np

import _picture
import handsight as hs
from handsight.simulation import Scenario, rig_of, simulate
from handsight.tracking import TrackerSettings

# Your robot has hs.Rig.from_file("rig.yaml"); here a simulated one is used, which also plays the robot below.
scenario = Scenario(object="box", motion="grasp", rate=50)
rig = rig_of(scenario)
model = hs.ObjectModel.box((0.06, 0.09, 0.14))

tracker = hs.Tracker(rig, model, settings=TrackerSettings(rate=25))
reported = None
curve = []  # time, error and sigma [s, mm]
for sample in simulate(scenario):
    robot = sample.observation
    observation = hs.Observation(
        stamp=robot.stamp,
        joint_positions=robot.joint_positions,  # by name, in any order
        wrenches=robot.wrenches,  # by finger, as the sensors read them
        vision=robot.vision,  # None if vision has no new pose
        T_world_palm=robot.T_world_palm,  # None: gravity, the table and a camera in the world are not used
    )
    estimate = tracker.update(observation)
    if estimate is None:
        continue  # nothing is known before vision's first pose
    off = np.linalg.norm(estimate.T_palm_object[:3, 3] - sample.T_palm_object[:3, 3])
    curve.append((observation.stamp, 1e3 * off, 1e3 * tracker.sigma))
    if (tracker.state, tracker.fingertips.fingers) != reported:
        reported = tracker.state, tracker.fingertips.fingers
        touching = ", ".join(tracker.fingertips.fingers) or "nothing"
        print(f"{observation.stamp:.2f} s: {tracker.state} {tracker.reason} (touching {touching})")

print("fingers without a contact:", dict(tracker.fingertips.reasons))
print("position in the palm [mm]:", (1e3 * estimate.T_palm_object[:3, 3]).round(1))
print(f"sigma {1e3 * tracker.sigma:.1f} mm, unobservable directions: {len(estimate.unobservable)}")

# How far the joints' constant errors move the contacts, by the hand's Jacobian.
pose = rig.hand.kinematics(robot.joint_positions)
tips = [list(rig.hand.tips).index(finger) for finger in tracker.fingertips.fingers]
by_joint = pose.jacobians(tracker.fingertips.contacts.points_palm, tips)[:, :3] * rig.sigma_joint_offset
each = np.sqrt((by_joint**2).sum(axis=(1, 2)).mean() / 3)
print(f"1 degree at each joint moves a contact by {1e3 * each:.1f} mm per axis")

error, covariance = tracker.vision_bias()
print(
    "estimate of vision's constant error [mm]:",
    (1e3 * error[:3]).round(),
    "±",
    (1e3 * np.sqrt(covariance.diagonal()[:3])).round(),
)

seconds, off, sigma = np.array(curve).T
_picture.over_time("In a control loop", seconds - seconds[0], {"error of the position": off, "sigma": sigma})
