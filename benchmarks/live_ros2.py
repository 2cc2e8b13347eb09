"""How long after a wrench the pose comes over ROS 2: `python -m benchmarks.live_ros2 [--node]`.

The robot, the bridge (or the node of rclpy, in the ROS 2 that `.ci/lab-ros2` makes) and one who listens are processes
of this machine, over loopback. A pose is late by the time from when the last message of its stamp was sent to when the
listener, a process of Python, has it. Played is what `benchmarks/live.py` plays to the node of ROS 1: 500 times a
second joint states, five wrenches and /tf, with poses of vision ten times a second, or with one alone at the start.
Only a quiet machine says anything of milliseconds.
"""

import argparse
import multiprocessing
import re
import tempfile
import time
from collections.abc import Mapping
from itertools import groupby
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from cyclonedds.core import DDSStatus, WaitSet
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from benchmarks.live import POSE, recording
from handsight.bridge.bridge import Network, carried, message_type
from handsight.messages import OwnTopic, RawMessage, RosType
from handsight.messages.decode import typestore
from handsight.messages.topics import rig_topics
from handsight.recording.mcap import McapSource
from handsight.rig import Rig
from tests.ros.ros2 import ALONE, BOTH_WAYS, Processes, processes

UNCOUNTED = 2.0
"""Of the recording [s]: clocks are compared, and kernels are loaded."""
Stamp = tuple[int, int]


def stamp_of(data: bytes) -> Stamp:
    """Returns the seconds and nanoseconds at the beginning of a header."""
    return int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")


def listen(told: Connection, environment: Mapping[str, str]) -> None:
    """Sends what was received when it is asked: stamps and times of poses, and the last diagnostics."""
    joined = Network(environment)
    readers = [
        DataReader(
            joined.participant, Topic(joined.participant, carried(topic), message_type(kind)), BOTH_WAYS
        )
        for topic, kind in ((POSE, RosType.POSE_COVARIANCE), (OwnTopic.DIAGNOSTICS, RosType.DIAGNOSTICS))
    ]
    filled = WaitSet(joined.participant)
    for reader in readers:
        reader.set_status_mask(DDSStatus.DataAvailable)
        filled.attach(reader)
    found, last = list[tuple[Stamp, int]](), b""
    told.send("listens")
    while not told.poll():
        filled.wait(50_000_000)
        taken, now = readers[0].take(100), time.time_ns()
        found += [
            (stamp_of(each.data), now)
            for each in taken
            if isinstance(each, message_type(RosType.POSE_COVARIANCE))
        ]
        for each in readers[1].take(10):
            last = each.data if isinstance(each, message_type(RosType.DIAGNOSTICS)) else last
    told.send((found, last))


def played(joined: Network, messages: list[RawMessage]) -> dict[Stamp, int]:
    """Returns by stamp when the last of its messages was sent, at the pace of the recording [ns]."""
    kinds = {each.topic: each.type for each in messages}
    writers: dict[str, Any] = {
        topic: DataWriter(
            joined.participant, Topic(joined.participant, carried(topic), message_type(kind)), qos=BOTH_WAYS
        )
        for topic, kind in kinds.items()
    }
    while not all(each.get_matched_subscriptions() for each in writers.values()):
        time.sleep(0.05)
    time.sleep(0.5)  # that others know of this one takes longer than that this one knows of them
    sent, begun, first = dict[Stamp, int](), time.monotonic(), messages[0].log_time
    for due, group in groupby(messages, lambda each: each.log_time):
        time.sleep(max(0.0, due - first - (time.monotonic() - begun)))
        for each in group:
            last = time.time_ns()
            writers[each.topic].write(message_type(each.type)(each.data))
            if due - first > UNCOUNTED and not each.topic.endswith("tf"):
                sent[stamp_of(each.data)] = last
    return sent


def measured(running: Processes, follower: Any, messages: list[RawMessage], name: str) -> str:
    """A row of the table."""
    ours, its = multiprocessing.Pipe()
    listener = multiprocessing.get_context("spawn").Process(target=listen, args=(its, ALONE))
    listener.start()
    ours.recv()
    process = psutil.Process(follower.pid)
    before, began = sum(process.cpu_times()[:2]), time.monotonic()
    sent = played(Network(ALONE), messages)
    share = (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)
    time.sleep(1.5)  # the diagnostics come once a second
    ours.send("enough")
    found, last = ours.recv()
    listener.join()
    late = 1e-6 * np.array([came - sent[stamp] for stamp, came in found if stamp in sent])
    told = typestore("cdr").deserialize_cdr(last, RosType.DIAGNOSTICS).status[1].values
    numbers = {each.key: each.value for each in told if re.fullmatch(r"[\d.]+", each.value)}
    middle, most, worst = np.percentile(late, [50, 90, 99])
    return (
        f"| {name} | {len(late)} of {len(sent)} | {middle:.2f} | {most:.2f} | {worst:.2f} | {100 * share:.0f} % "
        f"| {numbers['skipped as newer ones waited']} | {numbers['dropped']} | {running.interrupt(follower):.2f} s |"
    )


def said(bag: Path, rig: Path) -> list[RawMessage]:
    """Returns the robot's messages without the truth."""
    topics = rig_topics(Rig.from_file(rig))
    messages = McapSource(bag.with_suffix(".mcap")).messages(topics)
    return [each for each in messages if topics[each.topic].role != "truth"]


def main() -> None:
    """Prints the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=20.0)
    arguments.add_argument("--node", action="store_true", help="the node of rclpy rather than the bridge")
    given = arguments.parse_args()
    print("| vision | poses | median [ms] | 90 % | 99 % | of a core | skipped | dropped | Ctrl-C |")
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, sights in (("ten a second", True), ("one", False)):
            bag, rig = recording(Path(folder), given.seconds, sights=sights)
            with processes(Path(folder)) as running:
                follower = running.node(rig) if given.node else running.bridge(rig)
                print(measured(running, follower, said(bag, rig), name), flush=True)


if __name__ == "__main__":
    main()
