"""A rig from a `rig.yaml`, whose keys `handsight.rig.form` declares; unknown keys are errors."""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from handsight import checks
from handsight.contact import TactileSurface
from handsight.errors import HandsightError, InvalidFile, InvalidInput, MissingExtra
from handsight.hand import Hand, find_file
from handsight.hand.paths import PACKAGE
from handsight.msgspec_errors import FieldPath
from handsight.rig.form import GONE, VERSION, FramesForm, JointStatesForm, RigForm, SkinForm, WorldForm, keys
from handsight.rig.rig import NotUnique, Rig, Table, Topics
from handsight.rig.yaml_file import YamlFile


def load(path: Path) -> Rig:
    """Returns the rig of a file; raises an InvalidFile with the file, the line and the path of what is wrong."""
    file = YamlFile(path)
    version = file.values.get("version")
    if isinstance(version, int | float) and version != VERSION:  # its other keys are that version's
        raise file.error(("version",), f"expected {VERSION}, got {checks.brief(version)}")
    _check_gone(file)
    form = file.read(RigForm)
    world = form.world or WorldForm()
    hand = _hand(form, file)
    try:
        joint_names = form.hand.names(hand.joint_names)
    except ValueError as error:
        argument, _, message = str(error).partition(": ")
        raise file.error(("hand", "joints", argument), message) from None
    skin = {name: _surface(name, each, file, hand) for name, each in (form.skin or {}).items()}
    _check_joints(form, file, hand.joint_names, joint_names)
    try:
        return Rig(
            hand=hand,
            fingers={name: finger.finger() for name, finger in form.fingers.items()},
            camera=None if form.camera is None else form.camera.camera(),
            table=None if form.table is None else Table(**form.table.given()),
            gravity=np.array(world.gravity, dtype=np.float64),
            world_from=None if world.palm_from == "nowhere" else world.palm_from,
            frames=(form.frames or FramesForm()).given(),
            topics=_topics(form, file),
            objects={name: entry.entry(path.parent) for name, entry in (form.objects or {}).items()},
            skin=skin,
            joint_names=joint_names,
            **form.hand.sigmas(),
        )
    except NotUnique as error:
        raise file.error(error.path, error.message) from None


def _check_gone(file: YamlFile) -> None:
    """Raises InvalidFile for a key that was removed, with what to write instead."""
    skin = file.values.get("skin")
    if not isinstance(skin, Mapping):
        return
    for name, surface in skin.items():
        found = [key for key in GONE if isinstance(surface, Mapping) and key in surface]
        for key in found:
            expected = f"expected no such key, which was removed ({GONE[key]})"
            raise file.error(("skin", name, key), f"{expected}, got {checks.brief(surface[key])}")


def _check_joints(
    form: RigForm, file: YamlFile, joints: Collection[str], joint_names: Mapping[str, str]
) -> None:
    """Raises InvalidFile where the names of a driver's numbers are of no joint of the hand's file."""
    states = None if form.topics is None else form.topics.joint_states
    if not isinstance(states, JointStatesForm):
        return
    for i, name in enumerate(states.names or ()):
        if name is not None and joint_names.get(name, name) not in joints:
            expected = "expected a joint of the hand's file, or null for a number that is of none"
            message = f"{expected}, got {name!r}{checks.suggestion(name, joints)}"
            raise file.error(("topics", "joint_states", "names", i), message)


def _surface(name: str, form: SkinForm, file: YamlFile, hand: Hand) -> TactileSurface:
    """Returns a tactile surface; an error is about the key that it begins with."""
    try:
        surface = form.surface(file.path.parent, hand)
        hand.chains_to({"frame": surface.frame})  # whether the hand has its link
        return surface
    except (InvalidInput, InvalidFile) as error:
        argument, _, message = str(error).partition(": ")
        if argument in (key.text for key in keys(SkinForm)):
            raise file.error(("skin", name, argument), message) from None
        raise file.error(("skin", name), str(error)) from None


def _hand(form: RigForm, file: YamlFile) -> Hand:
    """Returns the hand; an error of its file is about the key that names the file, or the body that it lacks."""
    name = form.hand.file
    tips = {finger: values.frame for finger, values in form.fingers.items()}
    try:
        found = find_file(name, beside=file.path.parent)
        hand = Hand.from_file(found, palm=form.hand.palm, tips=tips)
    except MissingExtra:
        raise
    except HandsightError as error:
        # The error's first word says which body the hand's file does not have.
        argument, _, message = str(error).partition(": ")
        fields: dict[str, FieldPath] = {"palm": ("hand", "palm")}
        fields |= {f"tips[{finger!r}]": ("fingers", finger, "frame") for finger in tips}
        if argument in fields:
            raise file.error(fields[argument], message) from None
        raise file.error(("hand", "file"), str(error)) from None
    except OSError as error:
        raise file.error(("hand", "file"), f"{checks.brief(name)}: {error.strerror}") from None
    if name.startswith(PACKAGE):  # such a name is valid in a rig file anywhere
        hand.file = name
    return hand


def _topics(form: RigForm, file: YamlFile) -> Topics:
    """Returns the topics of the file, with the usual names of wrenches and skins that it leaves out."""
    given = {} if form.topics is None else form.topics.given()
    states = given.get("joint_states")
    if isinstance(states, JointStatesForm):
        given |= {"joint_states": states.topic, "joint_reading": states.reading()}
    folders = [file.path.parent / folder for folder in given.get("messages", ())]
    for i, folder in enumerate(folders):
        if not any(folder.glob("*.msg")):
            came = f"{checks.brief(str(folder))}, which has none"
            raise file.error(("topics", "messages", i), f"expected a folder of .msg files, got {came}")
    given["messages"] = tuple(str(folder.absolute()) for folder in folders)
    arrays = form.skin or {}
    for kind, what in (("wrenches", "finger"), ("contacts", "finger"), ("skin", "array of the skin")):
        known = arrays if kind == "skin" else form.fingers
        for name in given.get(kind, ()):
            if name not in known:
                raise file.error(("topics", kind, name), f"unknown {what}{checks.suggestion(name, known)}")
    for name, array in arrays.items():
        if array.topic is not None and name in given.get("skin", ()):
            raise file.error(("skin", name, "topic"), "expected here or in topics.skin, got both")
    for name in given.get("wrenches", ()):
        if form.fingers[name].sensor is None:
            raise file.error(("topics", "wrenches", name), f"expected a sensor in fingers.{name}, got none")
    wrenches = {
        name: f"/{name}/wrench"
        for name, finger in form.fingers.items()
        if finger.sensor is not None and name not in given.get("contacts", ())
    }
    skin = {name: array.topic or f"/{name}/taxels" for name, array in arrays.items()} | given.pop("skin", {})
    paths = {name: array.message_field for name, array in arrays.items() if array.message_field is not None}
    try:
        return Topics(**({"wrenches": wrenches} | given), skin=skin, skin_fields=paths)
    except InvalidInput as error:
        raise file.error(("topics", "offsets"), str(error).removeprefix("offsets: ")) from None
