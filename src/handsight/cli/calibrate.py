"""`handsight calibrate`: what is constantly wrong, from a recording."""

import math

import typer

from handsight.cli.options import ObjectName, Recorded, RigFile, rig_and_object
from handsight.cli.terminal import announce_compiling, say
from handsight.errors import InvalidInput

calibrate_app = typer.Typer(help="What is constantly wrong, from a recording.", no_args_is_help=True)


@calibrate_app.command("camera")
def camera(recording: Recorded, rig: RigFile = None, object: ObjectName = None) -> None:
    """The camera's constant error, from an object that was held while the palm turned.

    Vision's error stays where it is in the world while the palm turns with the object; so the two come apart, and touch
    says where the object is. Printed: the camera's corrected pose for the rig file, and how well it is known.
    """
    from handsight.recording import open_recording
    from handsight.rig.save import pose_text
    from handsight.tracking.camera_calibration import LITTLE_TURN, calibrate_camera

    announce_compiling()
    found, model = rig_and_object(recording, rig, object)
    with open_recording(recording, found) as opened:
        calibrated = calibrate_camera(opened.observations(), found, model)
    if calibrated is None:
        raise InvalidInput(f"{recording}: expected an object that is held and seen, got none")
    shift, turn = 1e3 * calibrated.correction[:3], calibrated.correction[3:]
    sigma = calibrated.covariance.diagonal() ** 0.5
    degrees = [[math.degrees(angle) for angle in part] for part in (turn, sigma[3:])]
    typer.echo(f"camera:\n  pose: {pose_text(calibrated.T_mount_camera)}")
    moved = "# shifted by [{:.1f}, {:.1f}, {:.1f}] mm at the object, turned by [{:.2f}, {:.2f}, {:.2f}]°"
    typer.echo(moved.format(*shift, *degrees[0]))
    known = "# known to ± [{:.1f}, {:.1f}, {:.1f}] mm, [{:.2f}, {:.2f}, {:.2f}]° (one standard deviation)"
    typer.echo(known.format(*(1e3 * sigma[:3]), *degrees[1]))
    if calibrated.turned < LITTLE_TURN:
        say(
            f"the palm turned by {math.degrees(calibrated.turned):.0f}° only: error and pose are hardly told apart"
        )
