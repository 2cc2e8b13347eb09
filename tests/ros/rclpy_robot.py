"""A robot of real ROS 2, run by its own Python: says messages at their pace, and keeps what is answered.

`rclpy_robot.py messages.pickle answers.pickle`; each message is (topic, type, seconds, bytes). Types that are not
installed are left out.
"""

import pickle
import sys
import time
from importlib import import_module

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy

ANSWERED = {
    "/handsight/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/handsight/markers": "visualization_msgs/msg/MarkerArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
KEPT = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)


def made(kind):
    package, room, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.{room}"), name)
    except ImportError:
        return None


def main(said, answered):
    with open(said, "rb") as file:
        messages = [each for each in pickle.load(file) if made(each[1])]
    rclpy.init()
    node, heard = rclpy.create_node("robot"), []
    for topic, kind in ANSWERED.items():
        if made(kind):

            def hear(data, topic=topic, kind=kind):
                heard.append((topic, kind, bytes(data)))

            node.create_subscription(made(kind), topic, hear, KEPT, raw=True)
    speak = {topic: node.create_publisher(made(kind), topic, KEPT) for topic, kind, *_ in messages}
    answers = [topic for topic, kind in ANSWERED.items() if made(kind)]
    while any(not each.get_subscription_count() for each in speak.values()) or any(
        not node.count_publishers(topic) for topic in answers
    ):
        rclpy.spin_once(node, timeout_sec=0.05)
    time.sleep(1.5)  # that others know of this one takes longer than that this one knows of them
    begun = time.monotonic()
    for topic, _, seconds, data in messages:
        while (left := seconds - messages[0][2] - (time.monotonic() - begun)) > 0:
            rclpy.spin_once(node, timeout_sec=left)
        speak[topic].publish(data)
    quiet, count = time.monotonic(), 0
    while time.monotonic() - quiet < (3.0 if count else 60.0):  # whoever follows may still be loading
        rclpy.spin_once(node, timeout_sec=0.1)
        if (poses := sum(topic == "/handsight/pose" for topic, *_ in heard)) > count:
            quiet, count = time.monotonic(), poses
    with open(answered, "wb") as file:
        pickle.dump(heard, file)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
