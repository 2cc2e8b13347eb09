"""Options that several commands share, and the values that they name: a rig, objects, and a `Run` of a recording."""

import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from typer import Argument, Option

from handsight.cli.terminal import announce_compiling, say
from handsight.errors import InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.tracking import Tracker, TrackerSettings

RecordingPath = Annotated[Path, Argument(help="A recording: MCAP, rosbag 1 (.bag), or a rosbag 2 folder.")]
RigPath = Annotated[
    Path | None,
    Option("--rig", help="Rig file of the robot. Default: RECORDING.rig.yaml, else rig.yaml, beside it."),
]
ObjectName = Annotated[
    str | None,
    Option(
        "--object",
        metavar="NAME|FILE",
        help="Name of an object of the rig or of the library, or a mesh file in metres. Default: the rig's object, "
        "if it has only one.",
    ),
]
LibraryPlace = Annotated[
    str | None,
    Option(
        "--library",
        metavar="FOLDER|URL",
        help="Library of objects. Default: $HANDSIGHT_LIBRARY, else ~/.local/share/handsight/library.",
    ),
]
Rate = Annotated[
    float | None,
    Option(min=0.1, help="Corrections per second. Default: whenever a contact has changed."),
]
Answer = Annotated[
    str,
    Option(
        metavar="best|maximum|mean",
        help="Which pose is reported: the maximum of the posterior, its mean, or best: the mean where the posterior is "
        "not Gaussian, else the maximum.",
    ),
]
Samples = Annotated[
    int,
    Option(
        min=0,
        help="Report the mean of this many samples of the posterior instead, as a slow check. 0: do not sample.",
    ),
]
OutsidePoints = Annotated[
    int,
    Option(min=0, help="Number of points on the hand's links, which cannot be inside the object. 0: none."),
]
WithImages = Annotated[
    bool,
    Option(help="Find the object in the recorded depth images; without images, use recorded poses of it."),
]
DEPTH_CAMERAS = "structured_light|time_of_flight|stereo"
"""Kinds of depth cameras, each with its own errors: the names in `handsight.vision.depth_noise`."""


Value = TypeVar("Value")


def renamed(new: Value, old: Value, names: tuple[str, str]) -> Value:
    """Returns an option's value under its new name, else under its former one, which causes a warning on stderr."""
    if old:
        say(f"handsight: {names[1]} is now {names[0]}; the old name goes with the next release")
    return new or old


def tracker_settings(**given: Any) -> "TrackerSettings":
    """Returns a tracker's settings from the values of options; raises an InvalidInput that names the option."""
    from handsight.tracking import TrackerSettings

    try:
        return TrackerSettings(**given)
    except InvalidInput as error:
        raise InvalidInput(f"--{str(error).removeprefix('settings.')}") from None


@dataclass(frozen=True, slots=True)
class Run:
    """A `Run` is the input of a command: a recording, the rig of the robot in it, and the object in the hand."""

    recording: Path
    rig: "Rig"
    model: "ObjectModel"
    settings: "TrackerSettings | None" = None
    alternatives: "tuple[ObjectModel, ...]" = ()
    """Other objects that may be in the hand."""

    @classmethod
    def of(
        cls,
        recording: Path,
        rig: Path | None,
        name: str | None,
        settings: "TrackerSettings | None" = None,
        alternatives: Sequence[str] = (),
    ) -> "Run":
        """Returns the run that a command's options name; raises InvalidInput, InvalidFile."""
        announce_compiling()
        found, path = find_rig(recording, rig)
        if name is None and len(found.objects) != 1:
            known = ", ".join(found.objects) or "none"
            raise InvalidInput(f"--object: expected one of the rig, got nothing; {path} has {known}")
        (model,) = find_models(() if name is None else (name,), found, path).values()
        others = find_models(alternatives, found, path).values() if alternatives else ()
        return cls(recording, found, model, settings, tuple(others))

    @contextlib.contextmanager
    def opened(self) -> "Iterator[tuple[Recording, Tracker]]":
        """Yields the open recording and a new tracker for it.

        If the rig's camera has no intrinsics, the recording's first CameraInfo gives them. Raises InvalidFile,
        MissingExtra.
        """
        from handsight.recording import open_recording
        from handsight.tracking import Tracker

        with open_recording(self.recording, self.rig) as recording:
            rig = recording.calibrated_rig()
            yield recording, Tracker(rig, self.model, settings=self.settings, alternatives=self.alternatives)


def rig_beside(recording: Path) -> Path:
    """Returns the path of a recording's own rig file, which `handsight simulate` writes."""
    return recording.with_suffix(".rig.yaml")


def find_rig(recording: Path, rig: Path | None) -> "tuple[Rig, Path]":
    """Returns the rig in a file (None: in the file beside the recording), and its path; raises InvalidInput."""
    from handsight.rig import Rig

    own = rig_beside(recording)
    places = [rig] if rig else [path for path in (own, recording.with_name("rig.yaml")) if path.exists()]
    if not places:
        raise InvalidInput(
            f"--rig: expected a rig file, got nothing, and there is neither {own.name} nor rig.yaml beside {recording}"
        )
    return Rig.from_file(places[0]), places[0]


def find_models(
    names: Iterable[str],
    rig: "Rig | None" = None,
    rig_path: Path | None = None,
    *,
    library: str | None = None,
    scale: float = 1.0,
    index: bool = False,
) -> "Mapping[str, ObjectModel]":
    """Returns the models of objects, by name; without names, those of all objects in the rig, else in the library.

    `rig_path`: the rig's file, for messages; `library`: None for the default one; `scale`: metres per unit of a mesh
    file; `index`: a large library may be answered with a `ShapeIndex` of it. Raises InvalidInput, InvalidFile.
    """
    from handsight.objects import Library
    from handsight.objects.library import NoLibrary, find_model

    objects, opened = {} if rig is None else rig.objects, Library(library)
    if wanted := tuple(names) or tuple(objects):
        place = "" if rig is None else str(rig_path)
        find = partial(find_model, library=opened, scale=scale, argument="--object")
        models = [find(name, objects, place) for name in wanted]
    elif rig is not None:
        raise InvalidInput(f"--object: expected one of the rig, got nothing; {rig_path} has none")
    else:
        message = "--object: expected a name of the library or a mesh file, got nothing"
        try:
            entries = opened.entries()
        except NoLibrary:
            raise InvalidInput(f"{message}; there is no library at {opened.place}") from None
        if not entries:
            raise InvalidInput(f"{message}; the library {opened.place} is empty")
        if index:
            from handsight.vision.object.shape_index import SHAPE_INDEX, ShapeIndex

            if len(entries) > SHAPE_INDEX.shortlist:
                return ShapeIndex(opened)
        models = [opened.model(entry) for entry in entries]
    by_name = {model.name: model for model in models}
    if len(by_name) < len(models):
        twice = next(name for name, count in Counter(model.name for model in models).items() if count > 1)
        raise InvalidInput(f"--object: expected objects of different names, got {twice!r} twice")
    return by_name
