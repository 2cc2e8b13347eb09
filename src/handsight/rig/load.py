"""`rig.yaml` to a rig: strict, versioned. docs/robots.md shows every key, `handsight.rig.form` what each may be."""

from pathlib import Path

import numpy as np

from handsight import checks
from handsight.errors import HandsightError, InvalidInput, MissingExtra
from handsight.hand import Hand, find_file
from handsight.hand.paths import PACKAGE
from handsight.rig.form import VERSION, FramesForm, RigForm, WorldForm
from handsight.rig.rig import Rig, Shared, Table, Topics
from handsight.rig.yaml_file import YamlFile


def load(path: Path) -> Rig:
    """The rig of a file; raises InvalidFile with file, line and path of what is wrong."""
    file = YamlFile(path)
    version = file.values.get("version")
    if isinstance(version, int | float) and version != VERSION:  # its other keys are that version's
        raise file.wrong(("version",), f"expected {VERSION}, got {checks.brief(version)}")
    form = file.read(RigForm)
    try:
        return _rig(form, file)
    except Shared as error:
        raise file.wrong(error.field, error.said) from None
    except InvalidInput as error:
        for name in form.skin or ():  # the rig alone knows whether the hand has its link
            if str(error).startswith(place := f"skin[{name!r}].frame: "):
                raise file.wrong(("skin", name, "frame"), str(error).removeprefix(place)) from None
        raise


def _rig(form: RigForm, file: YamlFile) -> Rig:
    world = form.world or WorldForm()
    return Rig(
        hand=_hand(form, file),
        fingers={name: finger.finger() for name, finger in form.fingers.items()},
        camera=None if form.camera is None else form.camera.camera(),
        table=None if form.table is None else Table(**form.table.given()),
        gravity=np.array(world.gravity, dtype=np.float64),
        world_from=None if world.palm_from == "nowhere" else world.palm_from,
        frames=(form.frames or FramesForm()).given(),
        topics=_topics(form, file),
        objects={name: said.entry(file.path.parent) for name, said in (form.objects or {}).items()},
        skin={name: said.array() for name, said in (form.skin or {}).items()},
        **form.hand.sigmas(),
    )


def _hand(form: RigForm, file: YamlFile) -> Hand:
    named, tips = form.hand.file, {name: finger.frame for name, finger in form.fingers.items()}
    try:
        found = find_file(named, beside=file.path.parent)
        hand = Hand.from_file(found, palm=form.hand.palm, tips=tips)
    except MissingExtra:
        raise
    except HandsightError as error:
        # Whose body it is that the file does not have says the error's first word.
        what, _, said = str(error).partition(": ")
        fields = {"palm": ("hand", "palm")} | {f"tips[{name!r}]": ("fingers", name, "frame") for name in tips}
        if what in fields:
            raise file.wrong(fields[what], said) from None
        raise file.wrong(("hand", "file"), str(error)) from None
    except OSError as error:
        raise file.wrong(("hand", "file"), f"{checks.brief(named)}: {error.strerror}") from None
    if named.startswith(PACKAGE):  # its name is as good in a rig file elsewhere
        hand.file = named
    return hand


def _topics(form: RigForm, file: YamlFile) -> Topics:
    said = {} if form.topics is None else form.topics.given()
    arrays = form.skin or {}
    for kind, what in (("wrenches", "finger"), ("contacts", "finger"), ("skin", "array of the skin")):
        known = arrays if kind == "skin" else form.fingers
        for name in said.get(kind, ()):
            if name not in known:
                raise file.wrong(("topics", kind, name), f"unknown {what}{checks.suggestion(name, known)}")
    felt = [name for name in form.fingers if name not in said.get("contacts", ())]
    usual = {"wrenches": {name: f"/{name}/wrench" for name in felt}}
    return Topics(**(usual | {"skin": {name: f"/{name}/taxels" for name in arrays}} | said))
