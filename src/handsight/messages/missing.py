"""What a rig needs and does not hear, in sentences."""

import difflib
from collections.abc import Iterable

from handsight.messages.report import Report
from handsight.messages.topics import TYPES, channels
from handsight.rig import Rig


def missing(rig: Rig, report: Report, frames: set[str], joint_names: set[str]) -> list[str]:
    """A sentence for each topic, frame and joint of the rig that was not heard; empty: nothing is missing.

    `frames`, `joint_names`: those that were heard.
    """
    topics, lacking = rig.topics, []
    calibrated = rig.camera is not None and rig.camera.intrinsics is not None
    for what, topic in (
        *((f"finger {finger}: no wrench", topic) for finger, topic in topics.wrenches.items()),
        ("no vision", topics.vision),
        ("no color images", topics.color),
        ("no depth images", topics.depth),
        ("no camera info", None if calibrated else topics.camera_info),
    ):
        lacking += [] if topic is None else _missing_topic(rig, report, topic, what)
    if rig.world_from == "tf" and topics.tf is not None:
        lacking += _missing_frames(rig, report, topics.tf, frames)
    if report.observations:
        for joint in rig.hand.moving:
            if joint not in joint_names:
                near = _nearest(joint, joint_names)
                lacking.append(f"joint {joint!r}: never on {topics.joint_states}{near}")
    return lacking


def _missing_topic(rig: Rig, report: Report, topic: str, what: str) -> list[str]:
    there = report.topics.get(topic)
    if there is None:
        return [f"{what} on {topic}{_nearest(topic, report.others)}"]
    expected = TYPES[channels(rig)[topic].role]
    if there.type not in expected:
        return [f"{what} on {topic}: expected {' or '.join(expected)}, got {there.type or 'no type'}"]
    return [f"{what} on {topic}: no message"] if report.ended and not there.messages else []


def _missing_frames(rig: Rig, report: Report, topic: str, frames: set[str]) -> list[str]:
    if not {topic, f"{topic}_static"} & report.topics.keys():
        return _missing_topic(rig, report, topic, "no transforms")
    if not report.ended:
        return []
    world, palm = (rig.frames[role].lstrip("/") for role in ("world", "palm"))
    unknown = [name for name in (world, palm) if name not in frames]
    if unknown:
        near = _nearest(unknown[0], frames)
        return [f"no transform of {' and '.join(map(repr, unknown))} on {topic}{near}"]
    if not report.placed:
        return [f"no transforms that lead from {world!r} to {palm!r} on {topic}"]
    absent = report.observations - report.placed
    said = f"no transform from {world!r} to {palm!r} in {absent} of {report.observations} observations"
    return [said] if absent else []


def _nearest(name: str, there: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, sorted(there), n=1, cutoff=0.5)
    return f"; the nearest is {near[0]!r}" if near else ""
