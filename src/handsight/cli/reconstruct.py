"""`handsight reconstruct`: a model of an object from a recording's depth images."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from handsight.cli.options import RecordingPath, RigPath, find_rig, renamed
from handsight.cli.terminal import announce_compiling, kept_going, live_rows, say
from handsight.errors import InvalidInput
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.vision.reconstruction.completion import ReconstructedModel
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
    former_robot_poses: Annotated[bool, Option("--given", hidden=True)] = False,
    former_in_hand: Annotated[bool, Option("--held", hidden=True)] = False,
) -> None:
    """Reconstruct a model of an object from a recording with depth images of many of its sides.

    Either move the camera around an object on a table. The object must be the one nearest to the middle of the first
    image; a hand in the image is left out. Or let the hand turn the object in front of the camera, away from everything
    else (`--in-hand`). The object's pose then follows the hand in the images, so the grip must not change; the surface
    near the hand, as under its fingers, stays unmeasured. Turn by a few degrees from view to view, and show as many
    sides as possible.

    The sides that no view shows are guessed: by a symmetry that contradicts no measurement, and by extending the lowest
    points straight down to the table, if there is one. In the file, `measured` is 1 for measured points and 0 for
    guesses, and `sigma` is the standard deviation [m].

    ```
    handsight reconstruct around.mcap --rig robot.yaml --output mustard.ply
    handsight correct problems.jsonl --output results.jsonl      # "object": {"mesh": "mustard.ply"}
    handsight objects add mustard.ply --name mustard
    ```

    After an error or Ctrl-C, the model from the views until then is written.
    """
    import numpy as np

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
    fusion = Fusion(align=not robot_poses and not in_hand, in_hand=in_hand)
    with open_recording(recording, found) as opened, live_rows(recording.name, Fusion.progress) as watch:
        with kept_going() as end:
            fusion.add_recording(opened, found, watch)
        if end.error is not None and fusion.reconstruction is None:
            raise end.error
        cut = opened.report.truncated
        messages = [f"{recording}: cut: {cut}; what lies before was read"] if cut else []
        messages += [end.message] if end.message else []
    try:
        model = fusion.model()
        content = ply_bytes(Shape(model.points, sigmas=model.sigmas), 1.0, model.measured)
        with write_errors(output):
            output.write_bytes(content)
        misfits = fusion.images - fusion.skipped - fusion.fitted
        size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(model.points, axis=0))
        guessed = "; ".join(model.guesses) or "nothing"
        messages += [
            f"{fusion.views} views fused of {fusion.images} depth images, {misfits} did not fit",
            f"{size} mm, {100 * model.share_measured:.0f} % of the surface measured; guessed: {guessed}",
            f"wrote {output}: {len(model.points)} points",
        ]
    finally:
        for sentence in messages:
            say(sentence)
    if end.exit_code:
        raise typer.Exit(end.exit_code)


@dataclass(slots=True, kw_only=True)
class Fusion:
    """A `Fusion` turns a recording's depth images into one surface."""

    align: bool
    """Whether views are aligned to the surface, or placed at the robot's poses."""
    in_hand: bool
    """Whether the object is in the hand, or on a table."""
    reconstruction: "Reconstruction | None" = None
    """None before the object was found."""
    images: int = 0
    """Number of depth images until now."""
    skipped: int = 0
    """Number of depth images before the object was found."""
    fitted: int = 0
    """Number of depth images that fitted the surface."""

    def add_recording(self, recording: "Recording", rig: "Rig", watch: "Callable[[Fusion], None]") -> None:
        """Fuses the depth images of a recording; raises InvalidInput where there are none."""
        import numpy as np

        from handsight import se3
        from handsight.recording.robot_images import in_hand_views, views_of
        from handsight.vision.reconstruction.reconstruct import Reconstruction, View
        from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, on_table

        with_depth = (each for each in recording.observations() if each.depth is not None)
        first = next(with_depth, None)
        if first is None:
            raise InvalidInput(f"recording: expected depth images on {rig.topics.depth}, got none")
        camera = recording.camera()
        T_reference_object = np.eye(4)
        for view in (in_hand_views if self.in_hand else views_of)(chain([first], with_depth), rig, camera):
            if self.reconstruction is None:
                in_hand = (view.T_camera_object, IN_HAND_BOUNDS)
                found = in_hand if self.in_hand else on_table(camera, view.depth)
                if found is None:
                    self.skipped = self.images = self.images + 1
                    continue
                T_camera_object, bounds = found
                T_reference_object = se3.inverse(view.T_camera_object) @ T_camera_object
                self.reconstruction = Reconstruction(camera, bounds)
            placed = View(view.depth, view.T_camera_object @ T_reference_object)
            self.fitted += self.reconstruction.grow(placed, estimate=self.align) is not None
            self.images += 1
            watch(self)

    def model(self) -> "ReconstructedModel":
        """Returns the object's model; raises InvalidInput where too little of it was measured."""
        from handsight.vision.reconstruction.completion import closed, one_object

        min_views, min_points = 5, 100
        if self.reconstruction is None:
            where = "in the hand" if self.in_hand else "on a table"
            raise InvalidInput(
                f"recording: expected an object {where}, got none in {self.images} depth images"
            )
        volume = self.reconstruction.volume
        if self.views < min_views:
            raise InvalidInput(
                f"recording: expected at least {min_views} views of different sides, got {self.views} "
                f"in {self.images} depth images, of which {self.fitted} fitted"
            )
        surface = one_object(volume.surface(), volume, table=not self.in_hand)
        if len(surface.points) < min_points:
            raise InvalidInput(
                f"recording: expected a surface of at least {min_points} points, got {len(surface.points)} "
                "(do depth, intrinsics and the camera's pose belong together?)"
            )
        return closed(surface, volume, table=not self.in_hand)

    @property
    def views(self) -> int:
        """Number of views in the surface."""
        return self.reconstruction.volume.views if self.reconstruction else 0

    def progress(self) -> list[tuple[str, str]]:
        """Returns names and values that show the progress."""
        return [("images", str(self.images)), ("fitted", str(self.fitted)), ("fused", str(self.views))]
