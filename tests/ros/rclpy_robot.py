"""A robot of real ROS 2, run by its own Python: does one thing after the other, and keeps what is answered.

`rclpy_robot.py steps.pickle answers.pickle`; a step is one of

* `("say", [(topic, type, seconds, bytes), ...])`: once each topic is listened to, at their pace;
* `("hear", topic, count)`: until that many messages have come;
* `("told", text)`: until diagnostics have it, since it last began to say something;
* `("set", name, text)`: a parameter of the node; `("call", service)`: a Trigger, whose answer is kept as a message is.
"""

import pickle
import sys
import time
from importlib import import_module

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

ANSWERED = {
    "/handsight/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/handsight/markers": "visualization_msgs/msg/MarkerArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
KEPT = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
ASKS = "/handsight/"
"""How topics begin by which a user asks for something."""
UNHEARD = "std_msgs/msg/String"
"""What nobody listens to on other topics."""
KNOWN_AFTER = 3.0
"""That others know of a publisher takes longer than that it knows of them: a second where Fast DDS asks again [s]."""
LIMIT = 60.0
"""Of waiting: who follows may still be loading [s]."""


def made(kind):
    package, room, name = kind.split("/")
    return getattr(import_module(f"{package}.{room}"), name)


class Robot:
    def __init__(self):
        self.node = rclpy.create_node("robot")
        self.heard = []
        self.speak = {}
        self.before = 0  # number of messages heard before it last began to say something
        for topic, kind in ANSWERED.items():

            def hear(data, topic=topic, kind=kind):
                self.heard.append((topic, kind, bytes(data)))

            self.node.create_subscription(made(kind), topic, hear, KEPT, raw=True)

    def wait_for(self, condition, what):
        begun = time.monotonic()
        while not condition():
            if time.monotonic() - begun > LIMIT:
                raise SystemExit(f"waited {LIMIT} s for {what}")
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def say(self, messages):
        self.before = len(self.heard)
        new = {topic: kind for topic, kind, *_ in messages if topic not in self.speak}
        for topic, kind in new.items():
            self.speak[topic] = self.node.create_publisher(made(kind), topic, KEPT)
        topics = {m[0] for m in messages if m[1] != UNHEARD or m[0].startswith(ASKS)}
        listened = [self.speak[topic] for topic in topics]
        self.wait_for(lambda: all(each.get_subscription_count() for each in listened), "one who listens")
        self.wait_for(lambda: all(map(self.node.count_publishers, ANSWERED)), "one who answers")
        time.sleep(KNOWN_AFTER if new else 0.0)
        begun = time.monotonic()
        for topic, _, seconds, data in messages:
            while (left := seconds - messages[0][2] - (time.monotonic() - begun)) > 0:
                rclpy.spin_once(self.node, timeout_sec=left)
            self.speak[topic].publish(data)

    def hear(self, topic, count):
        self.wait_for(lambda: sum(each[0] == topic for each in self.heard) >= count, f"{count} on {topic}")

    def told(self, text):
        def diagnosed():
            since = self.heard[self.before :]
            return any(text.encode() in data for topic, _, data in since if topic == "/diagnostics")

        # What is wrong is said for ten seconds, which may be over before a slow machine has said all.
        self.wait_for(diagnosed, text)

    def set(self, name, text):
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        wanted = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        assert self._asked(SetParameters, "/handsight/set_parameters", wanted).results[0].successful

    def call(self, service):
        answer = self._asked(Trigger, service, Trigger.Request())
        self.heard.append((service, "std_srvs/srv/Trigger", (answer.success, answer.message)))

    def _asked(self, kind, service, wanted):
        client = self.node.create_client(kind, service)
        self.wait_for(client.service_is_ready, service)
        future = client.call_async(wanted)
        self.wait_for(future.done, f"{service}'s answer")
        return future.result()


def main(steps, answered):
    rclpy.init()
    robot = Robot()
    with open(steps, "rb") as file:
        for name, *given in pickle.load(file):
            getattr(robot, name)(*given)
    with open(answered, "wb") as file:
        pickle.dump(robot.heard, file)
    robot.node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
