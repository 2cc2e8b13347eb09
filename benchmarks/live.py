"""How long after a wrench the pose comes, through a node of ROS 1: `python benchmarks/live.py`.

A master, the node, `rosbag play` and `rosbag record` are processes of this machine. The recorder, which is none of
Python's, notes when each message came to it: a pose is late by the time since the last message of its stamp. Played is
a simulated can that is grasped and held, 500 times a second joint states, five wrenches and /tf, with poses of vision
ten times a second, or in the first second alone. Only a quiet machine says anything of milliseconds.
"""

import argparse
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import psutil
from rosbags import rosbag1

from handsight.messages.read import typestore
from handsight.messages.topics import rig_topics
from handsight.objects import ObjectSpec
from handsight.observation import Observation
from handsight.recording import RecordingWriter
from handsight.recording.bags import Rosbag1Source
from handsight.recording.mcap import McapSource
from handsight.rig import Rig
from handsight.rig.save import write as write_rig
from handsight.simulation import Scenario, rig_of, simulate
from testbed.recordings import BEGINS
from tests.ros.ros1 import Graph, graph, messages_of

RATE = 500.0
POSE = "/handsight/pose"


def held(seconds: float) -> Iterator[Observation]:
    """Yields observations of a grasp, and then of its last half second forth and back, so that nothing jumps."""
    samples = [
        each.observation for each in simulate(Scenario(object="can", seed=1, motion="grasp", rate=RATE))
    ]
    tail = samples[-round(RATE / 2) :]
    visions = [each.vision for each in tail if each.vision is not None]
    yield from samples
    for k in count():
        stamp = samples[-1].stamp + (k + 1) / RATE
        if stamp > seconds:
            return
        i = k % (2 * len(tail))
        seen = tail[-1 - i] if i < len(tail) else tail[i - len(tail)]
        vision = visions[k % len(visions)] if k % round(RATE / 10) == 0 else None
        yield replace(seen, stamp=stamp, vision=vision)


def recording(folder: Path, seconds: float, *, sights: bool) -> tuple[Path, Path]:
    """Returns the paths of a bag and its rig."""
    rig = rig_of(Scenario())
    rig = replace(rig, objects={"can": ObjectSpec(cylinder=(0.033, 0.122))})
    path, rig_path = folder / f"{sights}.mcap", folder / "rig.yaml"
    write_rig(rig, rig_path)
    with RecordingWriter(path, rig) as writer:
        for seen in held(seconds):
            wanted = seen.vision if sights or seen.stamp < 1.0 else None
            writer.write(replace(seen, stamp=BEGINS + seen.stamp, vision=wanted))
    return as_bag(path, rig), rig_path


def as_bag(path: Path, rig: Rig) -> Path:
    """Returns the path of the same recording as a bag of ROS 1."""
    cdr, bag = typestore("cdr"), path.with_suffix(".bag")
    with closing(McapSource(path)) as source, rosbag1.Writer(bag) as writer:
        connections = {}
        for each in source.messages(rig_topics(rig)):
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(
                    each.topic, each.type, typestore=typestore("ros1")
                )
            data = cdr.cdr_to_ros1(each.data, each.type)
            sec = int(each.log_time)
            writer.write(connections[each.topic], sec * 10**9 + round((each.log_time - sec) * 1e9), data)
    return bag


def latencies(bag: Path, inputs: tuple[str, ...]) -> np.ndarray:
    """Returns the times (n,) from the last input of a stamp to its pose [s], after the first two seconds."""
    store, last, found = typestore("ros1"), dict[int, float](), list[tuple[int, float]]()
    with closing(Rosbag1Source(bag)) as source:
        for each in source.messages((*inputs, POSE)):
            message = store.deserialize_ros1(each.data, each.type)
            top = message.transforms[0].header if each.type.endswith("TFMessage") else message.header
            if each.type.endswith("TFMessage") and message.transforms[0].child_frame_id == "object":
                continue
            stamp = top.stamp.sec * 10**9 + top.stamp.nanosec
            if each.topic == POSE:
                found.append((stamp, each.log_time))
            else:
                last[stamp] = max(last.get(stamp, 0.0), each.log_time)
    begun = min(last) + 2 * 10**9
    return np.array([came - last[stamp] for stamp, came in found if stamp in last and stamp > begun])


def measured(running: Graph, rig: Path, bag: Path, name: str) -> str:
    """A row of the table."""
    node = running.node(rig)
    inputs = ("/joint_states", "/tf", *(f"/{finger}/wrench" for finger in ("ff", "mf", "rf", "lf", "th")))
    recorder = running.record(POSE, "/diagnostics", *inputs)
    before, began = sum(psutil.Process(node.pid).cpu_times()[:2]), os.times().elapsed
    play = running.run("rosbag", "play", "--quiet", "--wait-for-subscribers", "--delay=1", str(bag))
    play.wait()
    share = (sum(psutil.Process(node.pid).cpu_times()[:2]) - before) / (os.times().elapsed - began)
    path = running.recorded(recorder)
    ended = running.interrupt(node)
    late = 1e3 * latencies(path, inputs)
    told = messages_of(path, "/diagnostics")[-1].status[1].values
    numbers = {each.key: each.value for each in told if re.fullmatch(r"[\d.]+", each.value)}
    skipped, dropped = numbers["skipped as newer ones waited"], numbers["dropped"]
    middle, most, worst = np.percentile(late, [50, 90, 99])
    return (
        f"| {name} | {len(late)} | {middle:.2f} | {most:.2f} | {worst:.2f} | {100 * share:.0f} % "
        f"| {skipped} | {dropped} | {ended:.2f} s |"
    )


def main() -> None:
    """Prints the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=20.0)
    seconds = arguments.parse_args().seconds
    print("| vision | poses | median [ms] | 90 % | 99 % | of a core | skipped | dropped | Ctrl-C |")
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, sights in (("ten a second", True), ("at first", False)):
            bag, rig = recording(Path(folder), seconds, sights=sights)
            with graph(Path(folder)) as running:
                print(measured(running, rig, bag, name), flush=True)


if __name__ == "__main__":
    main()
