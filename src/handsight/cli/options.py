"""What the commands for recordings have in common: a recording, its rig and the object in it."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handsight.errors import InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.rig import Rig

Recorded = Annotated[Path, typer.Argument(help="MCAP, rosbag 1 (.bag), or a rosbag 2 folder.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="The robot; default: RECORDING.rig.yaml, else rig.yaml, beside the recording."
    ),
]
ObjectName = Annotated[
    str | None,
    typer.Option(
        "--object",
        help="A name of the rig's objects or of the library, or a mesh file in metres; default: the rig's only one.",
    ),
]


def rig_and_object(recording: Path, rig: Path | None, name: str | None) -> "tuple[Rig, ObjectModel]":
    """The rig of a recording and the model of the object in it, as told or as found; raises InvalidInput."""
    from handsight.objects import Library, ObjectModel
    from handsight.objects.library import NoLibrary
    from handsight.rig import Rig

    path = rig or _rig_beside(recording)
    found = Rig.from_file(path)
    if name is None:
        if len(found.objects) != 1:
            raise InvalidInput(
                f"--object: expected, got nothing; {path} knows {', '.join(found.objects) or 'none'}"
            )
        name = next(iter(found.objects))
    if name in found.objects:
        return found, replace(found.objects[name].model(), name=name)
    if Path(name).exists():
        return found, ObjectModel.from_file(name)
    library, listed = Library(), set[str]()
    with contextlib.suppress(NoLibrary):  # there need not be one
        listed = {entry.name for entry in library.entries()}
    if name in listed:
        return found, library.model(name)
    from handsight.checks import among

    known = among(name, {*found.objects, *listed})
    raise InvalidInput(f"--object: expected a name of {path} or a mesh file, got {name!r}{known}")


def own_rig(recording: Path) -> Path:
    """Where the rig of this one recording is."""
    return recording.with_suffix(".rig.yaml")


def _rig_beside(recording: Path) -> Path:
    own = own_rig(recording)
    for path in (own, recording.with_name("rig.yaml")):
        if path.exists():
            return path
    raise InvalidInput(
        f"--rig: expected, got nothing, and there is neither {own.name} nor rig.yaml beside {recording}"
    )
