"""Options that several commands share, and the values that they name: a rig, objects, and a `Run` of a recording."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from handsight.cli.terminal import announce_compiling
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
        help="Library of objects. Default: $HANDSIGHT_LIBRARY, else `handsight/library` in `~/.local/share`.",
    ),
]
WithImages = Annotated[
    bool,
    Option(help="Find the object in the recorded depth images; without images, use recorded poses of it."),
]
DEPTH_CAMERAS = "structured_light, time_of_flight or stereo"
"""Kinds of depth cameras, each with its own errors: the names in `handsight.vision.depth_noise`."""


def refuse(beside: str, **options: object) -> None:
    """Raises InvalidInput where an option is given that does not go with something else."""
    for name, given in options.items():
        if given:
            raise InvalidInput(f"--{name.replace('_', '-')}: expected none with {beside}, got some")


@dataclass(frozen=True, slots=True)
class Run:
    """The input of a command: a recording, the rig of the robot in it, and the object in the hand."""

    recording: Path
    rig: "Rig"
    model: "ObjectModel"
    settings: "TrackerSettings | None" = None

    @classmethod
    def of(
        cls,
        recording: Path,
        rig: Path | None,
        name: str | None,
        settings: "TrackerSettings | None" = None,
    ) -> "Run":
        """Returns the run that a command's options name; raises InvalidInput, InvalidFile."""
        announce_compiling()
        found, path = find_rig(recording, rig)
        if name is None and len(found.objects) != 1:
            known = ", ".join(found.objects) or "none"
            raise InvalidInput(f"--object: expected one of the rig, got nothing; {path} has {known}")
        (model,) = find_models(() if name is None else (name,), found, path).values()
        return cls(recording, found, model, settings)

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
            yield recording, Tracker(rig, self.model, settings=self.settings)


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
) -> "Mapping[str, ObjectModel]":
    """Returns the models of objects, by name; without names, those of all objects in the rig, else in the library.

    `rig_path`: the rig's file, for messages; `library`: None for the default one; `scale`: metres per unit of a mesh
    file. Raises InvalidInput, InvalidFile.
    """
    from handsight.objects import Library, ObjectModel, find_model
    from handsight.objects.library import NoLibrary
    from handsight.rig.units import check_held

    objects = {} if rig is None else rig.objects
    opened = Library(library)
    wanted = tuple(names) or tuple(objects)
    if not wanted and rig is None:
        with contextlib.suppress(NoLibrary):
            wanted = tuple(entry.name for entry in opened.entries())
    if not wanted:
        expected = (
            "expected a name of the library or a mesh file" if rig is None else "expected one of the rig"
        )
        raise InvalidInput(f"--object: {expected}, got nothing; {rig_path or opened.place} has none")
    by_name = dict[str, ObjectModel]()
    for name in wanted:
        place = "" if rig is None else str(rig_path)
        model = find_model(name, objects, place, library=opened, scale=scale, argument="--object")
        if rig is not None:
            check_held(rig, model)
        if model.name in by_name:
            raise InvalidInput(f"--object: expected objects of different names, got {model.name!r} twice")
        by_name[model.name] = model
    return by_name
