"""`handsight reconstruct`: an object's model out of a recording's depth images."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handsight.cli.options import Recorded, RigFile, renamed, rig_of_recording
from handsight.cli.terminal import announce_compiling, kept_going, live_rows, say
from handsight.errors import InvalidInput
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.vision.reconstruction.completion import ReconstructedModel
    from handsight.vision.reconstruction.reconstruct import Reconstruction

LEAST_FUSED, LEAST_POINTS = 5, 100
"""Views that a model is made of, and points that it has, or there is none."""


def reconstruct(
    recording: Recorded,
    output: Annotated[Path, typer.Option("--output", "-o", help="The model, a PLY of points in metres.")],
    rig: RigFile = None,
    robot_poses: Annotated[
        bool,
        typer.Option(
            "--robot-poses",
            help="Take the views to be where the robot has them; default: align each to the surface, from there on.",
        ),
    ] = False,
    in_hand: Annotated[
        bool,
        typer.Option(
            "--in-hand",
            help="The hand holds the object and turns it before the camera; default: it stands on a table.",
        ),
    ] = False,
    former_robot_poses: Annotated[bool, typer.Option("--given", hidden=True)] = False,
    former_in_hand: Annotated[bool, typer.Option("--held", hidden=True)] = False,
) -> None:
    """Make an object's model out of a recording with depth images of many sides of it.

    Move the camera around what stands on a table, nearest to the middle of the first image; a hand in the picture is
    left out. Or hold it in the hand and turn that before the camera, clear of all else (`--in-hand`): where it is
    goes by the hand that is seen, so keep the grip; what is near the hand, as under its fingers, stays unseen. Views
    a few degrees apart are enough; the more sides they show, the less is guessed.

    What no view shows is guessed where a symmetry contradicts nothing that was seen, and from the lowest that was seen
    straight down to the table, if there is one. The file's property `measured` is 1 for points that were seen and 0 for
    guesses, `sigma` is how far they may be off.

    ```
    handsight reconstruct around.mcap --rig robot.yaml --output mustard.ply
    handsight correct problems.jsonl --output results.jsonl      # "object": {"mesh": "mustard.ply"}
    handsight objects add mustard.ply --name mustard
    ```

    Whatever ends it early, Ctrl-C too, the model of the views by then is written.
    """
    from handsight.recording import open_recording

    announce_compiling()
    if output.suffix.lower() != ".ply":
        raise InvalidInput(f"--output: expected a name that ends with .ply, got {output.name!r}")
    found = rig_of_recording(recording, rig)
    if found.topics.depth is None:
        raise InvalidInput("topics.depth: expected the topic of the depth images in the rig, got none")
    in_hand = renamed(in_hand, former_in_hand, ("--in-hand", "--held"))
    robot_poses = renamed(robot_poses, former_robot_poses, ("--robot-poses", "--given"))
    run = Run(not robot_poses and not in_hand, in_hand)
    with open_recording(recording, found) as opened, live_rows(recording.name, Run.progress) as watch:
        with kept_going() as end:
            run.through(opened, found, watch)
        if end.error is not None and run.reconstruction is None:
            raise end.error
        cut = opened.report.truncated
        messages = [f"{recording}: cut: {cut}; what lies before was read"] if cut else []
        messages += [end.message] if end.message else []
    try:
        messages += write(run, output)
    finally:
        for sentence in messages:
            say(sentence)
    if end.exit_code:
        raise typer.Exit(end.exit_code)


@dataclass(slots=True)
class Run:
    """A `Run` is a recording's way into a surface."""

    estimate: bool
    in_hand: bool
    reconstruction: "Reconstruction | None" = None
    images: int = 0
    """Depth images that were looked at."""
    started: int = 0
    """How many of them before the object was seen."""
    fitted: int = 0

    def through(self, recording: "Recording", rig: "Rig", watch: "Callable[[Run], None]") -> None:
        """Fuses what a recording has; raises InvalidInput where that cannot be begun."""
        import numpy as np

        from handsight import se3
        from handsight.camera import Camera
        from handsight.recording.robot_images import in_hand_views, views_of
        from handsight.vision.reconstruction.reconstruct import Reconstruction, View
        from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, on_table

        with_depth = (each for each in recording.observations() if each.depth is not None)
        first = next(with_depth, None)
        if first is None:
            raise InvalidInput(f"recording: expected depth images on {rig.topics.depth}, got none")
        camera = recording.intrinsics or Camera.of(rig.camera)
        T_reference_object = np.eye(4)
        for view in (in_hand_views if self.in_hand else views_of)(chain([first], with_depth), rig, camera):
            if self.reconstruction is None:
                started = (
                    (view.T_camera_object, IN_HAND_BOUNDS) if self.in_hand else on_table(camera, view.depth)
                )
                if started is None:
                    self.started = self.images = self.images + 1
                    continue
                T_reference_object = se3.inverse(view.T_camera_object) @ started[0]
                self.reconstruction = Reconstruction(camera, started[1])
            placed = View(view.depth, view.T_camera_object @ T_reference_object)
            self.fitted += self.reconstruction.grow(placed, estimate=self.estimate) is not None
            self.images += 1
            watch(self)

    def model(self) -> "ReconstructedModel":
        """Returns the object; raises InvalidInput where too little of it was seen."""
        from handsight.vision.reconstruction.completion import closed, one_object

        if self.reconstruction is None:
            where = "in the hand" if self.in_hand else "on a table"
            messages = f"expected an object {where}, got none in {self.images} depth images"
            raise InvalidInput(f"recording: {messages}")
        volume = self.reconstruction.volume
        if volume.views < LEAST_FUSED:
            raise InvalidInput(
                f"recording: expected at least {LEAST_FUSED} views of different sides, got {volume.views} "
                f"in {self.images} depth images, of which {self.fitted} fitted"
            )
        surface = one_object(volume.surface(), volume, table=not self.in_hand)
        if len(surface.points) < LEAST_POINTS:
            raise InvalidInput(
                f"recording: expected a surface of at least {LEAST_POINTS} points, got {len(surface.points)} "
                "(do depth, intrinsics and the camera's pose belong together?)"
            )
        return closed(surface, volume, table=not self.in_hand)

    def progress(self) -> list[tuple[str, str]]:
        """Returns how it goes, as names and values."""
        views = self.reconstruction.volume.views if self.reconstruction else 0
        return [("images", str(self.images)), ("fitted", str(self.fitted)), ("fused", str(views))]


def write(run: Run, output: Path) -> list[str]:
    """Writes the model, and says what it is made of."""
    import numpy as np

    from handsight.objects.files import Shape, ply_bytes

    model = run.model()
    content = ply_bytes(Shape(model.points, sigmas=model.sigmas), 1.0, model.measured)
    with write_errors(output):
        output.write_bytes(content)
    size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(model.points, axis=0))
    views = run.reconstruction.volume.views if run.reconstruction else 0
    messages = [
        f"{views} views fused of {run.images} depth images, {run.images - run.started - run.fitted} did not fit"
    ]
    guessed = "; ".join(model.guesses) or "nothing"
    messages.append(f"{size} mm, {100 * model.share_measured:.0f} % of the surface seen; guessed: {guessed}")
    return [*messages, f"wrote {output}: {len(model.points)} points"]
