"""The first rig of a hand, guessed from the hand's file and a recording's messages, to be checked and completed."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.contact import Sphere, WrenchCalibration
from handsight.hand import Hand
from handsight.hand.guess import GuessedTip, guess_hand
from handsight.messages.match import (
    match_arrays,
    match_frames,
    match_joints,
    match_taxels,
    match_topics,
    may_touch,
)
from handsight.messages.survey import Survey
from handsight.rig import Finger, MountedCamera, Rig, Topics, save
from handsight.rig.layouts import known_places, said_places, tactile_sensors

MOST_UNUSED = 40
"""Arrays that nothing reads which are listed in a new rig."""
NO_SENSOR = (
    "no finger has a sensor, so none can touch: fingers.X.sensor, a topic in topics.contacts, or taxels in skin on the "
    "finger's frame"
)


def first_rig(
    file: Path, recorded: Survey | None, *, palm: str | None = None, taxels: str | None = None
) -> tuple[list[str], str]:
    """Returns what was guessed of a hand, in sentences, and the text of its rig, which has them at its head.

    `file`: the hand's URDF or MJCF. `recorded`: what is in a recording's messages, whose topics the rig is to have;
    None: there is no recording. `palm`: the palm's link; None: it is guessed. `taxels`: the taxels of a tip, as a
    number or the file of a table. Raises InvalidInput, InvalidFile.
    """
    asked = palm is not None
    palm, tips = guess_hand(file, palm)
    hand = Hand.from_file(file, palm=palm, tips={name: tip.link for name, tip in tips.items()})
    found = Survey() if recorded is None else recorded
    topics, used = match_topics(found.types, list(tips))
    skin, guessed_of_skin = _skin(file, tips, found, taxels)
    lines = [] if asked else [f"palm: {palm}, the link that all fingers hang on"]
    fingers = _fingers(tips, lines)
    open_ends = list[str]()
    joint_names = dict[str, str]()
    frames = dict[str, str]()
    if recorded is None:
        topics = Topics(wrenches={name: f"/{name}/wrench" for name in tips})
    else:
        stated = topics.joint_states if topics.joint_states in found.types else None
        joints = match_joints(found, hand, stated)
        joint_names = joints.joint_names
        heard_on = joints.topic or topics.joint_states
        topics = dataclasses.replace(topics, joint_states=heard_on, joint_reading=joints.reading)
        frames, guessed_of_frames, open_of_frames = match_frames(found, palm, topics.vision)
        lines += [*joints.guessed, *guessed_of_frames]
        open_ends += [*joints.open_ends, *open_of_frames]
    in_images = topics.vision is not None or topics.depth is not None
    rig = Rig(
        hand=hand,
        fingers=fingers,
        camera=MountedCamera() if in_images else None,
        world_from="tf" if topics.tf is not None else None,
        frames={"world": "world", "palm": "palm", "camera": "camera"} | frames,
        joint_names=joint_names,
        topics=topics,
    )
    lines += [f"topic {topic}: {what}" for topic, what in used.items()]
    lines += guessed_of_skin
    heard = {str(entry.get("topic")) for entry in skin.values()}
    others = found.types.keys() - used.keys() - heard - {topics.joint_states}
    if others:
        lines.append(f"not used: {', '.join(sorted(others))}")
    if not (topics.wrenches or topics.contacts or skin):
        open_ends.append(NO_SENSOR)
    if topics.wrenches:
        open_ends.append("each sensor's pose, reading (on_sensor or on_tip), noise, bias and tip_mass")
    open_ends.append("the camera's pose, and objects" if in_images else "objects")
    filled = [f"to fill in: {what}" for what in open_ends]
    head = [f"# Guessed: {line}" for line in lines] + [f"# T{line[1:]}" for line in filled]
    surfaces = [f"  {save.inline(name)}: {save.inline(entry)}" for name, entry in skin.items()]
    if surfaces:
        guess = "each at the end of its tip, z out of the skin, y along its columns: measure, count"
        surfaces = [f"# Guessed: {guess}; see docs/sensors.md", "skin:", *surfaces]
    read = {(str(entry.get("topic")), str(entry.get("field"))) for entry in skin.values()}
    if topics.joint_reading is not None:
        read.add((topics.joint_states, topics.joint_reading.field))
    unused = _unused(found, read)
    text = "\n".join([*head, save.text(rig).rstrip(), *surfaces, *unused, ""])
    return [*lines, *filled], text


def _fingers(tips: Mapping[str, GuessedTip], lines: list[str]) -> dict[str, Finger]:
    """Returns the fingers with the tips that were guessed, and adds a line for each."""
    unread = WrenchCalibration(np.zeros(3), np.zeros(3), 0.0, np.zeros(3), reading="on_sensor")
    fingers = dict[str, Finger]()
    for name, tip in tips.items():
        T = tip.T_link_surface
        shape = Sphere(tip.radius, cap=-tip.radius / 2, T_surface_sensor=se3.inverse(T))
        fingers[name] = Finger(frame=tip.link, T_frame_surface=T, tip=shape, calibration=unread)
        why = "by its shape" if tip.of_shape else "as the link has no shape"
        size = f"a sphere of {1000 * tip.radius:.1f} mm {why}: measure it"
        lines.append(f"finger {name}: {tip.link} is its tip, {size}")
    return fingers


def _unused(found: Survey, read: set[tuple[str, str]]) -> list[str]:
    """Returns comments with the arrays in messages of drivers that nothing in the rig reads, and how they would be.

    `read`: the topics and paths of the rig.
    """
    lines = list[str]()
    known = {(topic, path.rpartition("[")[0] if ":" in path else path) for topic, path in read}
    unread = [array for at, array in found.arrays.items() if at not in known]
    arrays = [array for array in unread if array.topic in found.unknown]
    if arrays:
        lines.append(
            "# Found in messages of types that are not known here, and not used. As taxels, under skin:"
        )
        lines.append(
            '#   thumb_tip: {frame: LINK, taxels or file or layout: ..., topic: "/TOPIC", field: "PATH"}'
        )
        lines.append(
            '# As joint states, under topics: {joint_states: {topic: "/TOPIC", field: "PATH", names: [...]}}'
        )
    lines += [f"#   {array}" for array in arrays[:MOST_UNUSED]]
    if len(arrays) > MOST_UNUSED:
        lines.append(f"#   and {len(arrays) - MOST_UNUSED} more")
    for topic in sorted(found.unread):
        kind = found.types[topic]
        lines.append(f"# Not read: {topic}, as the recording lacks the definition of {kind}: record as MCAP")
    return lines


def _skin(
    file: Path, tips: Mapping[str, GuessedTip], found: Survey, taxels: str | None
) -> tuple[dict[str, dict[str, object]], list[str]]:
    """Returns the rig's entries of tactile surfaces, and what was guessed of them.

    They are those of the hand's URDF, else one at the end of each tip. `taxels`: as the command's option.
    """
    sensors = tactile_sensors(file)
    if sensors:
        matched = match_taxels(found.types, list(sensors))
        heard = {name: {key: matched[name][key] for key in ("topic", "field")} for name in matched}
        skin = {name: {"urdf": name, "threshold": 0.1, **heard.get(name, {})} for name in sensors}
        lines = [
            f"skin {name}: of {entry.get('topic', 'a topic to fill in')}" for name, entry in skin.items()
        ]
        return skin, lines
    places, lines = (known_places(), []) if taxels is None else said_places(taxels, Path())
    touch = found.unknown | {topic for topic, kind in found.types.items() if may_touch(topic, kind)}
    arrays = [array for array in found.arrays.values() if array.topic in touch]
    entries = match_arrays(arrays, list(tips), places)
    if not entries:
        entries = match_taxels(found.types, list(tips))
        paths = {(str(entry["topic"]), str(entry["field"])) for entry in entries.values()}
        if {topic for topic, _ in paths} <= found.unknown and not paths & found.arrays.keys():
            entries = {}  # of another type of that name
    skin = {}
    for name, entry in entries.items():
        tip = tips[name.partition("_")[0]]
        T = tip.T_link_surface
        pose = se3.position_quaternion(T) | {"position": T[:3, 3] + tip.radius * T[:3, 2]}
        surface = name if "_" in name else f"{name}_tip"
        skin[surface] = {"frame": tip.link, **({} if "file" in entry else {"pose": pose}), **entry}
        of = f"{entry['field']} on {entry['topic']}"
        grid = "{rows} x {columns}".format(**entry) if "rows" in entry else "it is"
        layout = entry.get("layout") or entry.get("file") or grid
        lines.append(f"skin {surface}: {of}, by its length laid out as {layout}")
    return skin, lines
