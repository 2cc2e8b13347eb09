"""`handsight objects weigh`: what a recording tells of an object's mass and its centre, written to the library."""

from dataclasses import replace
from typing import Annotated

import typer

from handsight.cli.options import Recorded, RigFile, rig_of_recording, with_intrinsics
from handsight.cli.terminal import announce_compiling, say
from handsight.errors import InvalidInput

WORST = 0.01
"""A centre of mass that is not known as well is not worth writing down: one standard deviation per axis [m]."""


def weigh(
    recording: Recorded,
    name: Annotated[str, typer.Option("--object", help="Its name in the library, or its number.")],
    rig: RigFile = None,
    library: Annotated[
        str | None,
        typer.Option("--library", metavar="FOLDER", help="The library; default: as for the others."),
    ] = None,
) -> None:
    """Find an object's mass and centre of mass in a recording, and write both to the library.

    In it the hand lifts the object and tilts it by 20° about two axes, holding still for half a second each time. The
    centre is as uncertain as the object's pose in the hand is, too.

    ```
    handsight objects weigh lifted.mcap --object mustard
    ```
    """
    from handsight.objects import Library
    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.replay import best_weight

    announce_compiling()
    opened, robot = Library(library), rig_of_recording(recording, rig)
    model = opened.model(name)
    with open_recording(recording, robot) as opened_once:
        robot = with_intrinsics(robot, opened_once)
    # What is known already must not come out again as if it had been measured.
    tracker = Tracker(robot, replace(model, mass=None, center_of_mass=None))
    with open_recording(recording, robot) as read:
        found, reason = best_weight(read.observations(), tracker)
    if found is None:
        raise InvalidInput(
            f"{recording.name}: expected an object that is weighed in the air, got none: {reason}"
        )
    center, sigma = found.kept_by_symmetries(model)
    place = ", ".join(f"{1e3 * x:.1f}" for x in center)
    text = f"{1e3 * found.mass:.4g} ± {1e3 * found.sigma_mass:.2g} g, centre [{place}] ± {1e3 * sigma:.1f} mm per axis"
    say(f"{model.name}: {text}, by {found.directions} directions of gravity")
    if sigma > WORST:
        raise InvalidInput(
            f"{recording.name}: expected a centre of mass known to {1e3 * WORST:g} mm, got {1e3 * sigma:.1f} mm: not "
            "written (where the object is in the hand must be known: by more contacts, or by vision)"
        )
    opened.weigh(name, found.mass, center, sigma)
    say(f"wrote {opened.place}")
