#!/usr/bin/env python3
"""Tracks the object in a robot's hand: messages of ROS 2 in, its pose out. No estimation is done here.

Parameters: rig (the rig file), object (its name in the rig, in the library, or a mesh file; may be left out where the
rig knows one), rate (corrections a second; 0: one when something changed), images (use depth images, true), equal
(answer as `handsight track` does with a recording, 0.2 s later, false), view (port of a page that shows it in the
browser; 0: none). Topics are the rig's: see docs/live.md.
"""

import re
import signal
import sys
import threading
import time
from importlib import import_module
from operator import itemgetter

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from handsight.errors import HandsightError
from handsight.live.node import (
    done,
    live_tracker,
    parameters,
    queue_lengths,
    time_to_wait,
    work,
)
from handsight.messages import OwnTopic, RawMessage
from handsight.viewer import view

OF_ROS = "use_sim_time", "start_type_description_service", "qos_overrides"
"""Parameters that every node has, and of which one begins so."""
LASTING = QoSProfile(
    depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)
"""The quality of service of topics that are published once, for whoever subscribes later."""
PLAIN_TYPES = {"double": "float64", "float": "float32", "boolean": "bool", "octet": "byte"}
"""Names of numbers in definitions, by those that message classes have for them."""


def made(package, room, name):
    """Returns the class of a message or service; None: its package is not installed."""
    try:
        return getattr(import_module(f"{package}.{room}"), name)
    except (ImportError, AttributeError):
        return None


def definition(message):
    """Returns the definition of a message's class, and of those that it is made of, as recordings have it.

    It is from the class itself: any type whose package is sourced can be read so.
    """
    texts, waiting, known = [], [message], {message}
    while waiting:
        each, lines = waiting.pop(), []
        for name, kind in each.get_fields_and_field_types().items():
            count, bounded = "", re.fullmatch(r"sequence<(.+?)(?:, (\d+))?>", kind)
            if bounded:
                kind, count = bounded[1], f"[<={bounded[2]}]" if bounded[2] else "[]"
            elif fixed := re.fullmatch(r"(.+)(\[\d+\])", kind):
                kind, count = fixed.groups()
            if "/" in kind:
                package, part = kind.split("/")
                found = made(package, "msg", part)
                waiting += [] if found in known else [found]
                known.add(found)
            kind = re.sub(r"string<(\d+)>", r"string<=\1", kind)
            lines.append(f"{PLAIN_TYPES.get(kind, kind)}{count} {name}")
        package = each.__module__.split(".")[0]
        texts.append((f"MSG: {package}/{each.__name__}\n" if texts else "") + "\n".join(lines))
    return f"\n{'=' * 80}\n".join(texts)


def tracker(node):
    """Returns the tracker that the parameters describe."""
    declared = node.get_parameters_by_prefix("")
    given = parameters({name: each.value for name, each in declared.items() if not name.startswith(OF_ROS)})
    for name, value in given.items():
        if name not in declared:
            node.declare_parameter(name, value)
    port = given.pop("view")
    live = live_tracker(given.pop("rig"), given.pop("object"), encoding="cdr", **given)
    say = node.get_logger().info
    say(f"follows {live.tracker.model.name}")
    if port:
        live.show = view(live.tracker, port=port, say=say).update
    return live


class Ears:
    """Subscriptions to a tracker's topics; of a topic that may have several types, to the one that is published."""

    def __init__(self, node, live):
        self._node, self._live = node, live
        self._subscribed, self.heard = {}, time.monotonic()
        for topic, kinds in live.subscriptions.items():
            known = [kind for kind in kinds if made(*kind.split("/"))]
            if known:
                self._subscribe(topic, known[0])
            else:
                node.get_logger().warning(f"{topic} is not heard: {kinds[0].split('/')[0]} is not installed")
        node.create_timer(1.0, self.look)

    def __len__(self):
        return len(self._subscribed)

    def look(self):
        """Subscribes anew where a topic is published with another type that is expected, and reports other types."""
        for topic, kinds in self._live.subscriptions.items():
            published = [each.topic_type for each in self._node.get_publishers_info_by_topic(topic)]
            self._live.publishers(topic, len(published))
            now = self._subscribed.get(topic, ("",))[0]
            any_defined = topic in self._live.any_defined
            better = [kind for kind in published if (any_defined or kind in kinds) and made(*kind.split("/"))]
            for kind in published:
                if kind not in better:
                    self._live.published(topic, kind)
            if better and now not in published:
                self._subscribe(topic, better[0])

    def _subscribe(self, topic, kind):
        if topic in self._subscribed:
            self._node.destroy_subscription(self._subscribed.pop(topic)[1])
        waiting, _ = queue_lengths(self._live)
        passing = QoSProfile(depth=waiting, reliability=ReliabilityPolicy.BEST_EFFORT)

        text = definition(made(*kind.split("/"))) if topic in self._live.any_defined else ""

        def hear(data, info):
            self._hear(topic, kind, text, data, info)

        quality = LASTING if topic.endswith("/tf_static") else passing
        subscription = self._node.create_subscription(made(*kind.split("/")), topic, hear, quality, raw=True)
        self._subscribed[topic] = kind, subscription, text

    def _hear(self, topic, kind, text, data, info):
        """Hands over a message and all others that have come, in the order of their arrival.

        The executor would wait anew for each message, and hand over those of one topic after those of another.
        """
        taken = [(info["received_timestamp"], topic, kind, data, text)]
        for topic, (kind, subscription, text) in self._subscribed.items():
            with subscription.handle:
                while (more := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                    taken.append((more[1]["received_timestamp"], topic, kind, more[0], text))
        self.heard, now = time.monotonic(), 1e-9 * self._node.get_clock().now().nanoseconds
        for _, topic, kind, data, text in sorted(taken, key=itemgetter(0)):
            self._live.put(RawMessage(topic, kind, "cdr", now, bytes(data), text))


def publisher(node, live):
    """Returns a function that publishes an answer; a subscriber that never reads blocks nothing."""
    found, (_, waiting) = {}, queue_lengths(live)
    for topic, kind in live.publications.items():
        if (message := made(*kind.split("/"))) is not None:
            found[topic] = node.create_publisher(message, topic, waiting)
        else:
            node.get_logger().warning(f"{topic} is not published: {kind.split('/')[0]} is not installed")
    markers = found.get(OwnTopic.MARKERS)
    live.markers_wanted = lambda: markers is not None and markers.get_subscription_count() > 0

    def publish(answer):
        if answer.topic in found:
            found[answer.topic].publish(answer.data)

    return publish


class Worker:
    """Receives and works in one thread: two would wait for each other's hold on Python."""

    def __init__(self, node, live, ears):
        self._live, self._ears, self._executor = live, ears, SingleThreadedExecutor()
        self._executor.add_node(node)

    def step(self, timeout):
        """Returns what is to be published now; waits at most `timeout` [s] for something to come."""
        self._executor.spin_once(timeout_sec=time_to_wait(timeout, self._ears.heard))
        return self._live.step(0.0)


def serve(node, live, publish):
    """Offers services that start a new track: from vision, or of the object that the parameter names now."""
    trigger = made("std_srvs", "srv", "Trigger")
    if trigger is None:
        node.get_logger().warning("there are no services: std_srvs is not installed")
        return

    def answer(ask):
        def asked():
            future = ask()
            for each in live.step(0.0):  # this thread does the work
                publish(each)
            return future

        def handle(_, response):
            response.success, response.message = done(asked)
            return response

        return handle

    def set_object():
        return live.set_object(str(node.get_parameter("object").value))

    node.create_service(trigger, "~/reset", answer(live.reset))
    node.create_service(trigger, "~/set_object", answer(set_object))


def main():
    """Runs until Ctrl-C; the exit code is 0 then."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("handsight", automatically_declare_parameters_from_overrides=True)
    try:
        live = tracker(node)
    except HandsightError as error:
        raise SystemExit(f"handsight: {error}") from None
    publish = publisher(node, live)
    serve(node, live, publish)
    ears, say = Ears(node, live), node.get_logger().info
    worker = Worker(node, live, ears)
    say(f"is ready: {len(ears)} topics are heard")
    work(live, worker.step, publish, say, ended)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
