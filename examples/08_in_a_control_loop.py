"""In a control loop: joints, raw wrenches and now and then a seen pose go in; the pose, and its worth, comes out."""

import numpy as np

import handsight as hs
from handsight.simulation import Scenario, rig_of, simulate
from handsight.tracking import TrackerSettings

# hs.Rig.from_file("rig.yaml") of your robot; here the simulated one, which also plays the robot below.
scenario = Scenario(object="box", motion="grasp", rate=50)
rig = rig_of(scenario)
model = hs.ObjectModel.box((0.06, 0.09, 0.14))

tracker = hs.Tracker(rig, model, settings=TrackerSettings(rate=25))
said = None
for sample in simulate(scenario):
    robot = sample.observation
    observation = hs.Observation(
        stamp=robot.stamp,
        joint_positions=robot.joint_positions,  # by name, in any order
        wrenches=robot.wrenches,  # by finger, as the sensors read them
        vision=robot.vision,  # None where vision has nothing new
        T_world_palm=robot.T_world_palm,  # None costs gravity, the table and a camera that stands in the world
    )
    estimate = tracker.update(observation)
    if estimate is None:
        continue  # neither a start nor vision so far
    if (tracker.state, tracker.fingertips.fingers) != said:
        said = tracker.state, tracker.fingertips.fingers
        touching = ", ".join(tracker.fingertips.fingers) or "nothing"
        print(f"{observation.stamp:.2f} s: {tracker.state} {tracker.reason} (touching {touching})")

print("why the others do not count:", dict(tracker.fingertips.reasons))
print("position in the palm [mm]:", (1e3 * estimate.T_palm_object[:3, 3]).round(1))
print(f"sigma {1e3 * tracker.sigma:.1f} mm, directions that touch leaves open: {len(estimate.unobservable)}")

# What the joints' constant error does to the contacts, through the hand's Jacobian.
pose = rig.hand.kinematics(robot.joint_positions)
tips = [list(rig.hand.tips).index(finger) for finger in tracker.fingertips.fingers]
by_joint = pose.jacobians(tracker.fingertips.contacts.points_palm, tips)[:, :3] * rig.sigma_joint_offset
each = np.sqrt((by_joint**2).sum(axis=(1, 2)).mean() / 3)
print(f"1 degree at each joint moves a contact by {1e3 * each:.1f} mm per axis")

error, covariance = tracker.vision_bias()
print(
    "vision's constant error so far [mm]:",
    (1e3 * error[:3]).round(),
    "±",
    (1e3 * np.sqrt(covariance.diagonal()[:3])).round(),
)
