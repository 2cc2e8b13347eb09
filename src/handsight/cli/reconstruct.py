"""`handsight reconstruct`: a model of an object from a recording's depth images."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from handsight.cli.options import RecordingPath, RigPath, find_rig
from handsight.cli.terminal import announce_compiling, bar, kept_going, say
from handsight.errors import InvalidInput
from handsight.files import binary_file

if TYPE_CHECKING:
    from handsight.recording import Recording
    from handsight.rig import Rig
    from handsight.vision.reconstruction.reconstruct import Reconstruction, View
    from handsight.vision.reconstruction.volume import SurfacePoints


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
) -> None:
    """Reconstruct a model of an object from a recording with depth images of many of its sides.

    Either move the camera around an object on a table. The object must be the one nearest to the middle of the first
    image; a hand in the image is left out. Or let the hand turn the object in front of the camera (`--in-hand`), in one
    grip. The object's pose then follows the hand in the images. Turn by a few degrees from view to view, and show
    as many sides as possible.

    On a table the lowest points are extended straight down to it. Other sides that no view shows stay open. In the
    file, `sigma` is the standard deviation [m] of the error that a point shares with its neighbours.

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
    from handsight.vision.reconstruction.parts import SIGMA, SIGMA_FOOT, foot

    announce_compiling()
    if output.suffix.lower() != ".ply":
        raise InvalidInput(f"--output: expected a name that ends with .ply, got {output.name!r}")
    found, _ = find_rig(recording, rig)
    if found.topics.depth is None:
        raise InvalidInput("topics.depth: expected the topic of the depth images in the rig, got none")
    fusion = Fusion(align=not robot_poses and not in_hand, in_hand=in_hand)
    with open_recording(recording, found) as opened, bar("reconstructing") as move:
        with kept_going() as end:
            fusion.add_recording(opened, found, move)
        if end.error is not None and fusion.reconstruction is None:
            raise end.error
        messages = opened.report.faults[:1]
        messages += [end.message] if end.message else []
    try:
        surface, sentences = fusion.surface()
        points = surface.points
        sigmas = np.full(len(points), SIGMA)
        if not in_hand:
            below = foot(surface, fusion.cell).points
            points = np.concatenate([points, below])
            sigmas = np.append(sigmas, np.full(len(below), SIGMA_FOOT))
        content = ply_bytes(Shape(points, sigmas=sigmas), 1.0)
        with binary_file(output) as file:
            file.write(content)
        messages += [*sentences, f"wrote {output}: {len(points)} points"]
    finally:
        say(*messages)
    if end.exit_code:
        raise typer.Exit(end.exit_code)


@dataclass(slots=True, kw_only=True)
class Fusion:
    """One surface out of a recording's depth images."""

    align: bool
    """Whether views are aligned to the surface, or placed at the robot's poses."""
    in_hand: bool
    """Whether the object is in the hand, or on a table."""
    reconstruction: "Reconstruction | None" = None
    """None before the object was found."""
    first: "View | None" = None
    """The first view of the object."""
    images: int = 0
    """Number of depth images until now."""
    skipped: "Counter[str]" = field(default_factory=Counter)
    """Number of depth images that were left out, by reason."""
    fitted: int = 0
    """Number of depth images that fitted the surface."""

    def add_recording(self, recording: "Recording", rig: "Rig", move: Callable[..., None]) -> None:
        """Fuses the depth images of a recording; raises InvalidInput where there are none."""
        import numpy as np

        from handsight import se3
        from handsight.recording.robot_images import in_hand_views, views_of
        from handsight.vision.reconstruction.reconstruct import Reconstruction
        from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, on_table

        with_depth = (each for each in recording.observations() if each.depth is not None)
        first = next(with_depth, None)
        if first is None:
            raise InvalidInput(f"recording: expected depth images on {rig.topics.depth}, got none")
        camera = recording.camera()
        T_reference_object = np.eye(4)
        for view in (in_hand_views if self.in_hand else views_of)(chain([first], with_depth), rig, camera):
            if self.reconstruction is None and not isinstance(view, str):
                if self.in_hand:
                    self.reconstruction = Reconstruction(camera, IN_HAND_BOUNDS)
                elif (found := on_table(camera, view.depth)) is None:
                    view = "no object on a table"
                else:
                    T_reference_object = se3.inverse(view.T_camera_object) @ found[0]
                    self.reconstruction = Reconstruction(camera, found[1])
            if self.reconstruction is None or isinstance(view, str):
                self.skipped[str(view)] += 1
            else:
                placed = replace(view, T_camera_object=view.T_camera_object @ T_reference_object)
                self.first = self.first or placed
                self.fitted += self.reconstruction.grow(placed, estimate=self.align) is not None
            self.images += 1
            move(None, f"{self.images} images, {self.views} fused")

    def surface(self) -> "tuple[SurfacePoints, list[str]]":
        """Returns the object's surface, and sentences about it; raises InvalidInput where too little was measured."""
        import numpy as np

        from handsight.vision.reconstruction.parts import above_table, in_fingers, share_observed

        min_views = 5
        min_points = 100
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
        volume = self.reconstruction.volume
        tips = None if self.first is None else self.first.tips_object
        surface = above_table(volume) if tips is None else in_fingers(volume, tips)
        if len(surface.points) < min_points:
            hint = "(do depth, intrinsics and the camera's pose belong together?)"
            expected = f"expected a surface of at least {min_points} points"
            raise InvalidInput(f"recording: {expected}, got {len(surface.points)} {hint}")
        size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(surface.points, axis=0))
        shown = (
            f"{size} mm, at most {100 * share_observed(surface, volume):.0f} % of the closed surface measured"
        )
        return surface, [*sentences, shown]

    @property
    def cell(self) -> float:
        """Side of a cell of the volume [m]; 0 before the object was found."""
        return self.reconstruction.volume.grid.cell if self.reconstruction else 0.0

    @property
    def views(self) -> int:
        """Number of views in the surface."""
        return self.reconstruction.views if self.reconstruction else 0

    @property
    def reasons(self) -> str:
        """Why images were left out, in brackets, or nothing."""
        counted = ", ".join(f"{reason}: {count}" for reason, count in self.skipped.most_common())
        return f" ({counted})" if counted else ""
