"""The demo's recordings, message by message, as a robot would send them."""

from contextlib import closing
from functools import lru_cache

import numpy as np

from handsight.cli.demo import DATA
from handsight.live import LiveTracker
from handsight.messages import ObservationStream, RosType
from handsight.messages.read import typestore
from handsight.messages.topics import rig_topics
from handsight.recording.mcap import McapSource
from handsight.rig import Rig
from handsight.tracking import Tracker
from handsight.tracking.replay import Tally, replay

START, SECONDS = 1000.0, 1.6
"""The first stamp, and how much of it is played [s]: the fingers have closed by then."""


@lru_cache
def rig(name="can"):
    return Rig.from_file(DATA / f"{name}.rig.yaml")


@lru_cache
def model(name="can"):
    return rig(name).objects[name].model()


@lru_cache
def said(name="can", seconds=SECONDS):
    """The first messages of a recording."""
    with closing(McapSource(DATA / f"{name}.mcap")) as source:
        messages = list(source.messages(rig_topics(rig(name))))
    return tuple(each for each in messages if each.log_time - messages[0].log_time <= seconds)


def in_ros1(messages):
    """The same as ROS 1 would say it."""
    cdr = typestore("cdr")
    return tuple(
        each._replace(encoding="ros1", data=bytes(cdr.cdr_to_ros1(each.data, each.type))) for each in messages
    )


def tracked(messages, name="can"):
    """Stamps and poses, as `handsight track` has them."""
    stream = ObservationStream(rig(name))
    observations = [seen for each in messages for seen in stream.put(each)] + stream.finish()
    steps = replay(observations, Tracker(rig(name), model(name)), Tally())
    return {round(step.stamp, 6): step.estimate.T_palm_object for step in steps}


def live(encoding="cdr", **options):
    return LiveTracker(rig(), model(), encoding=encoding, **options)


def answered(tracker, messages, *, at_once=1):
    """All that is answered to messages that come so many at once, and then no more."""
    answers = []
    for k in range(0, len(messages), at_once):
        for each in messages[k : k + at_once]:
            tracker.put(each)
        answers += tracker.step(0.0)
    tracker._came -= 2.0  # nothing has come for long
    return answers + tracker.step(0.0)


def read(answer, encoding="cdr"):
    return getattr(typestore(encoding), f"deserialize_{encoding}")(answer.data, answer.type)


def poses(answers, encoding="cdr"):
    """By stamp: position, quaternion and covariance."""
    found = {}
    for each in answers:
        if each.type == RosType.POSE_COVARIANCE:
            message = read(each, encoding)
            stamp, pose = message.header.stamp, message.pose.pose
            p, q = pose.position, pose.orientation
            values = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
            found[round(stamp.sec + 1e-9 * stamp.nanosec, 6)] = np.array(values), message.pose.covariance
    return found
