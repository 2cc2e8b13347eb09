"""What the commands for recordings have in common: a recording, its rig and the object in it."""

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import say
from handsight.errors import InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel, ObjectSpec
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings

Recorded = Annotated[Path, typer.Argument(help="MCAP, rosbag 1 (.bag), or a rosbag 2 folder.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="The robot; default: RECORDING.rig.yaml, else rig.yaml, beside the recording."
    ),
]
DEPTH_CAMERAS = "structured_light|time_of_flight|stereo"
"""How a camera measures depth, and so what is wrong with it: the names of `handsight.vision.depth_noise`."""
ObjectName = Annotated[
    str | None,
    typer.Option(
        "--object",
        help="A name of the rig's objects or of the library, or a mesh file in metres; default: the rig's only one.",
    ),
]
Rate = Annotated[
    float | None, typer.Option(min=0.1, help="Corrections a second; default: when something changed.")
]
Answer = Annotated[
    str,
    typer.Option(
        metavar="best|maximum|mean",
        help="Pose of the best mode; best: the mean where the posterior is not Gaussian, else the maximum.",
    ),
]
Samples = Annotated[
    int, typer.Option(min=0, help="Answer with the mean of so many posterior samples instead: a slow check.")
]
OutsideCount = Annotated[
    int,
    typer.Option(
        min=0, help="How many points of the hand's links, none of which can be inside the object; 0: none."
    ),
]
WithImages = Annotated[
    bool,
    typer.Option(
        help="Look at the recording's depth images, in place of a camera's poses; else at the poses."
    ),
]


def _settings(
    rate: Rate = None,
    answer: Answer = "best",
    samples: Samples = 0,
    outside: OutsideCount = 200,
    images: WithImages = True,
) -> "TrackerSettings":
    from handsight.tracking import TrackerSettings

    return TrackerSettings(rate=rate, answer=answer, samples=samples, outside=outside, images=images)


def renamed(new: bool, old: bool, names: tuple[str, str]) -> bool:
    """Returns a switch that was given under its new or its former name; a warning on stderr names the new one."""
    if old:
        say(f"handsight: {names[1]} is now {names[0]}; the old name goes with the next release")
    return new or old


def with_settings(command: Callable[..., None]) -> Callable[..., None]:
    """Returns a command whose argument `settings` is made of a tracker's options, which stand in its place."""
    options = signature(_settings, eval_str=False).parameters
    shown = dict[str, Parameter]()
    for name, parameter in signature(command, eval_str=False).parameters.items():
        shown |= options if name == "settings" else {name: parameter}

    @wraps(command)
    def run(**given: Any) -> None:
        settings = _settings(**{name: given.pop(name) for name in options})
        command(settings=settings, **given)

    # What typer reads.
    run.__annotations__ = {name: parameter.annotation for name, parameter in shown.items()}
    vars(run)["__signature__"] = Signature(
        [parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in shown.values()]
    )
    return run


def rig_and_object(recording: Path, rig: Path | None, name: str | None) -> "tuple[Rig, ObjectModel]":
    """Returns the rig of a recording and the model of the object in it, as told or as found; raises InvalidInput."""
    found, path = _rig_of(recording, rig)
    if name is None:
        if len(found.objects) != 1:
            raise _no_object(found, path)
        name = next(iter(found.objects))
    return found, object_named(name, objects=found.objects, of=str(path))


def rig_and_objects(
    recording: Path, rig: Path | None, names: Iterable[str]
) -> "tuple[Rig, dict[str, ObjectModel]]":
    """Returns the rig and, by name, the models of the objects told, else of all that it knows; raises InvalidInput."""
    found, path = _rig_of(recording, rig)
    wanted = tuple(names) or tuple(found.objects)
    if not wanted:
        raise _no_object(found, path)
    return found, by_name(object_named(name, objects=found.objects, of=str(path)) for name in wanted)


def library_objects(library: str | None) -> "dict[str, ObjectModel]":
    """Returns the models of all that a library (None: the usual one) has, by name; raises InvalidInput where it has
    none."""
    from handsight.objects import Library
    from handsight.objects.library import NoLibrary

    opened, message = Library(library), "expected a name of the library or a mesh file, got nothing"
    try:
        entries = opened.entries()
    except NoLibrary:
        raise InvalidInput(f"--object: {message}; there is no library at {opened.place}") from None
    if not entries:
        raise InvalidInput(f"--object: {message}; the library {opened.place} is empty")
    return by_name(opened.model(entry.name) for entry in entries)


def by_name(models: "Iterable[ObjectModel]") -> "dict[str, ObjectModel]":
    """Models by their names; raises InvalidInput where two have the same."""
    found = dict[str, "ObjectModel"]()
    for model in models:
        if model.name in found:
            raise InvalidInput(f"--object: expected objects of different names, got {model.name!r} twice")
        found[model.name] = model
    return found


def object_named(
    name: str,
    *,
    objects: "Mapping[str, ObjectSpec] | None" = None,
    of: str = "",
    library: str | None = None,
    scale: float = 1.0,
) -> "ObjectModel":
    """Returns the object of a rig's `objects`, of a mesh file or of the library; raises InvalidInput where there is
    none.

    `of`: what the rig is called; `scale`: metres per unit of a mesh file; `library`: None: the usual one.
    """
    from handsight.checks import suggestion
    from handsight.objects import Library, ObjectModel
    from handsight.objects.library import NoLibrary

    objects = objects or {}
    if name in objects:
        return replace(objects[name].model(), name=name)
    if Path(name).is_file():
        return ObjectModel.from_file(name, scale=scale)
    opened, listed = Library(library), dict[str, str]()
    with contextlib.suppress(NoLibrary):  # there need not be one
        for entry in opened.entries():
            listed |= dict.fromkeys((entry.name, str(entry.number), entry.file[:-4]), entry.name)
    if name in listed:
        return opened.model(listed[name])
    where = of or (
        f"the library {opened.place}" if listed else f"a library (there is none at {opened.place})"
    )
    known = suggestion(name, {*objects, *listed.values()})
    raise InvalidInput(f"--object: expected a name of {where} or a mesh file, got {name!r}{known}")


def rig_of_recording(recording: Path, rig: Path | None) -> "Rig":
    """Returns the rig of a recording, as told or as found beside it; raises InvalidInput."""
    return _rig_of(recording, rig)[0]


def own_rig(recording: Path) -> Path:
    """Returns where the rig of this one recording is."""
    return recording.with_suffix(".rig.yaml")


def _rig_of(recording: Path, rig: Path | None) -> "tuple[Rig, Path]":
    """Returns the rig as told or as found, and where it is."""
    from handsight.rig import Rig

    path = rig or _rig_beside(recording)
    return Rig.from_file(path), path


def _no_object(rig: "Rig", path: Path) -> InvalidInput:
    known = ", ".join(rig.objects) or "none"
    return InvalidInput(f"--object: expected, got nothing; {path} knows {known}")


def _rig_beside(recording: Path) -> Path:
    own = own_rig(recording)
    for path in (own, recording.with_name("rig.yaml")):
        if path.exists():
            return path
    raise InvalidInput(
        f"--rig: expected, got nothing, and there is neither {own.name} nor rig.yaml beside {recording}"
    )


def with_intrinsics(rig: "Rig", recording: "Recording") -> "Rig":
    """Returns the rig, its camera's intrinsics from the recording's first CameraInfo where it has none of its own."""
    return recording.calibrated_rig()
