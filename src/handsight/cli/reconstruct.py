"""`handsight reconstruct`: a model of an object from a recording's depth images."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from handsight.cli.options import RecordingPath, RigPath, find_rig, renamed
from handsight.cli.terminal import announce_compiling, kept_going, live_rows, say
from handsight.errors import InvalidInput
from handsight.files import atomic_file, write_errors

if TYPE_CHECKING:
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.vision.reconstruction.completion import ReconstructedModel
    from handsight.vision.reconstruction.grips import InHandReconstruction
    from handsight.vision.reconstruction.reconstruct import Reconstruction


def reconstruct(
    recording: RecordingPath,
    output: Annotated[Path, Option("--output", "-o", help="File for the model: a PLY of points in metres.")],
    rig: RigPath = None,
    robot_poses: Annotated[
        bool,
        Option(
            "--robot-poses",
            help="Use the robot's poses of the camera without aligning the views. Default: align each view to the "
            "surface, starting from the robot's pose.",
        ),
    ] = False,
    in_hand: Annotated[
        bool,
        Option(
            "--in-hand",
            help="The hand holds the object and turns it in front of the camera. Default: the object is on a table.",
        ),
    ] = False,
    guesses: Annotated[
        bool,
        Option(
            "--guesses",
            help="Guess what no view has shown by symmetry: this can be off by centimetres. Default: the surface stays "
            "open there.",
        ),
    ] = False,
    former_robot_poses: Annotated[bool, Option("--given", hidden=True)] = False,
    former_in_hand: Annotated[bool, Option("--held", hidden=True)] = False,
) -> None:
    """Reconstruct a model of an object from a recording with depth images of many of its sides.

    Either move the camera around an object on a table. The object must be the one nearest to the middle of the first
    image; a hand in the image is left out. Or let the hand turn the object in front of the camera (`--in-hand`). The
    object's pose then follows the hand in the images. After a new grip the surface is aligned with that of the grip
    before, if enough of it is seen in both; so what the fingers hid becomes visible. Turn by a few degrees from view to
    view, and show as many sides as possible.

    The sides that no view shows stay open, or are guessed by a symmetry that contradicts no measurement (`--guesses`).
    On a table the lowest points are extended straight down to it. In the file, `measured` is 1 for measured points and
    0 for guesses, and `sigma` is the standard deviation [m].

    ```
    handsight reconstruct around.mcap --rig robot.yaml --output mustard.ply
    handsight correct problems.jsonl --output results.jsonl      # "object": {"mesh": "mustard.ply"}
    handsight objects add mustard.ply --name mustard
    ```

    After an error or Ctrl-C, the model from the views until then is written.
    """
    from handsight.objects.files import Shape, ply_bytes
    from handsight.recording import open_recording

    announce_compiling()
    if output.suffix.lower() != ".ply":
        raise InvalidInput(f"--output: expected a name that ends with .ply, got {output.name!r}")
    found, _ = find_rig(recording, rig)
    if found.topics.depth is None:
        raise InvalidInput("topics.depth: expected the topic of the depth images in the rig, got none")
    in_hand = renamed(in_hand, former_in_hand, ("--in-hand", "--held"))
    robot_poses = renamed(robot_poses, former_robot_poses, ("--robot-poses", "--given"))
    fusion = Fusion(align=not robot_poses and not in_hand, in_hand=in_hand, guesses=guesses)
    with open_recording(recording, found) as opened, live_rows(recording.name, Fusion.progress) as watch:
        with kept_going() as end:
            fusion.add_recording(opened, found, watch)
        if end.error is not None and fusion.reconstruction is None:
            raise end.error
        cut = opened.report.truncated
        messages = [f"{recording}: cut: {cut}; what lies before was read"] if cut else []
        messages += [end.message] if end.message else []
    try:
        model, sentences = fusion.model()
        content = ply_bytes(Shape(model.points, sigmas=model.sigmas), 1.0, model.measured)
        with write_errors(output), atomic_file(output) as file:
            file.write(content)
        messages += [*sentences, f"wrote {output}: {len(model.points)} points"]
    finally:
        say(*messages)
    if end.exit_code:
        raise typer.Exit(end.exit_code)


@dataclass(slots=True, kw_only=True)
class Fusion:
    """A `Fusion` turns a recording's depth images into one surface."""

    align: bool
    """Whether views are aligned to the surface, or placed at the robot's poses."""
    in_hand: bool
    """Whether the object is in the hand, or on a table."""
    guesses: bool = False
    """Whether the model has what symmetries say of sides that no view has shown."""
    reconstruction: "Reconstruction | InHandReconstruction | None" = None
    """None before the object was found."""
    images: int = 0
    """Number of depth images until now."""
    skipped: "Counter[str]" = field(default_factory=Counter)
    """Number of depth images that were left out, by reason."""
    fitted: int = 0
    """Number of depth images that fitted the surface."""

    def add_recording(self, recording: "Recording", rig: "Rig", watch: "Callable[[Fusion], None]") -> None:
        """Fuses the depth images of a recording; raises InvalidInput where there are none."""
        import numpy as np

        from handsight import se3
        from handsight.recording.robot_images import in_hand_views, views_of
        from handsight.vision.reconstruction.grips import InHandReconstruction
        from handsight.vision.reconstruction.reconstruct import Reconstruction
        from handsight.vision.reconstruction.segmentation import on_table

        with_depth = (each for each in recording.observations() if each.depth is not None)
        first = next(with_depth, None)
        if first is None:
            raise InvalidInput(f"recording: expected depth images on {rig.topics.depth}, got none")
        camera = recording.camera()
        T_reference_object = np.eye(4)
        for view in (in_hand_views if self.in_hand else views_of)(chain([first], with_depth), rig, camera):
            if self.reconstruction is None and not isinstance(view, str):
                if self.in_hand:
                    self.reconstruction = InHandReconstruction(camera)
                elif (found := on_table(camera, view.depth)) is None:
                    view = "no object on a table"
                else:
                    T_reference_object = se3.inverse(view.T_camera_object) @ found[0]
                    self.reconstruction = Reconstruction(camera, found[1])
            if self.reconstruction is None or isinstance(view, str):
                self.skipped[str(view)] += 1
            else:
                placed = replace(view, T_camera_object=view.T_camera_object @ T_reference_object)
                self.fitted += self.reconstruction.grow(placed, estimate=self.align) is not None
            self.images += 1
            watch(self)

    def model(self) -> "tuple[ReconstructedModel, list[str]]":
        """Returns the object's model, and sentences about it; raises InvalidInput where too little was measured."""
        import numpy as np

        from handsight.vision.reconstruction.completion import closed, one_object, share_observed
        from handsight.vision.reconstruction.grips import InHandReconstruction

        min_views, min_points = 5, 100
        if self.reconstruction is None:
            where = "in the hand" if self.in_hand else "on a table"
            came = f"none in {self.images} depth images{self.reasons}"
            raise InvalidInput(f"recording: expected an object {where}, got {came}")
        if self.views < min_views:
            came = f"{self.views} in {self.images} depth images, of which {self.fitted} fitted{self.reasons}"
            raise InvalidInput(
                f"recording: expected at least {min_views} views of different sides, got {came}"
            )
        misfits = self.images - self.skipped.total() - self.fitted
        used = f"{self.views} views fused of {self.images} depth images, {misfits} did not fit"
        sentences = [used + (f"; left out{self.reasons}" if self.skipped else "")]
        if isinstance(self.reconstruction, InHandReconstruction):
            volume, surface, grips = self.reconstruction.merged()
            sentences += grips
        else:
            volume = self.reconstruction.volume
            surface = one_object(volume.surface(), volume, table=True)
        if len(surface.points) < min_points:
            hint = "(do depth, intrinsics and the camera's pose belong together?)"
            expected = f"expected a surface of at least {min_points} points"
            raise InvalidInput(f"recording: {expected}, got {len(surface.points)} {hint}")
        model = closed(surface, volume, table=not self.in_hand, symmetries=self.guesses)
        size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(model.points, axis=0))
        observed, guessed = 100 * share_observed(surface, volume), "; ".join(model.guesses) or "nothing"
        shown = f"{size} mm, at most {observed:.0f} % of the closed surface measured; guessed: {guessed}"
        return model, [*sentences, shown]

    @property
    def views(self) -> int:
        """Number of views in the surface."""
        return self.reconstruction.views if self.reconstruction else 0

    @property
    def reasons(self) -> str:
        """Why images were left out, in brackets, or nothing."""
        counted = ", ".join(f"{reason}: {count}" for reason, count in self.skipped.most_common())
        return f" ({counted})" if counted else ""

    def progress(self) -> list[tuple[str, str]]:
        """Returns names and values that show the progress."""
        return [("images", str(self.images)), ("fitted", str(self.fitted)), ("fused", str(self.views))]
