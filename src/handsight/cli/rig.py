"""`handsight rig check` and `handsight calibrate camera`: what describes a robot, against what it recorded."""

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.options import ObjectName, Recorded, RigFile, rig_and_object
from handsight.cli.terminal import announce_compiling, kept_going, say, table
from handsight.cli.track_summary import refusals
from handsight.errors import HandsightError, InvalidInput, printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from handsight.checks import Array
    from handsight.observation import Observation
    from handsight.rig import MountedCamera, Rig
    from handsight.tracking.camera_calibration import CameraCalibration, HandCalibration

rig_app = typer.Typer(help="What describes a robot: hand, fingertips, camera.", no_args_is_help=True)
calibrate_app = typer.Typer(help="What is constantly wrong, from a recording.", no_args_is_help=True)


@rig_app.command("check")
def check(
    rig: Annotated[Path, typer.Argument(help="A rig.yaml.")],
    recording: Annotated[Path | None, typer.Argument(help="A recording to check it against.")] = None,
    object: ObjectName = None,
) -> None:
    """Print the rig as a table, what a recording lacks for it, and links whose shapes are larger than they are.

    Such a link would be inside the object in the recording while the fingertips' contacts fit.
    The exit code is 1 where the recording lacks something that tracking needs, touch of any finger among it.
    """
    from handsight.rig import Rig

    found = Rig.from_file(rig)
    _print_rig(found, str(rig))
    if recording is None:
        return
    from handsight.recording import open_recording

    with open_recording(recording, found) as opened:
        untouched = _untouched(opened.observations(), found)
        lacking = [*opened.report.sentences(), *opened.lacks()]
    for sentence in (*lacking, *untouched):
        typer.echo(printable(f"- {sentence}"))
    if lacking or len(untouched) == len(found.fingers):
        raise typer.Exit(1)
    typer.echo(printable(f"{recording.name} has everything that this rig listens to."))
    _print_links(recording, rig, object)


def _print_links(recording: Path, rig: Path, name: str | None) -> None:
    """Tracks a recording, and prints by how much each link's shape is larger than the link."""
    from rich.console import Console

    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Tally, replay

    try:
        found, model = rig_and_object(recording, rig, name)
    except InvalidInput as error:
        typer.echo(printable(f"Shapes of the links were not looked at: {error}"))
        return
    announce_compiling()
    tracker = Tracker(found, model)
    if not tracker.links:
        lacks = "the hand's file has no shapes" if model.closed else "the object has no inside"
        typer.echo(printable(f"No link keeps the object out: {lacks}."))
        return
    with open_recording(recording, found) as opened:
        for _ in replay(opened.observations(), tracker, Tally()):
            pass
    margins = tracker.link_margins
    rows = [
        [printable(link), f"{1e3 * margins[link]:.1f}" if link in margins else "-"] for link in tracker.links
    ]
    out = Console(markup=False, highlight=False)
    out.print("", table(("link", "larger than it is by [mm]"), rows, texts=1, box=None, pad_edge=False))


def _untouched(observations: "Iterable[Observation]", rig: "Rig") -> list[str]:
    """Returns a sentence for each finger that was heard and never touched, with how near it came."""
    from handsight.tracking.fingertips import FingertipSensors

    sensors, largest, touched = FingertipSensors(rig), dict[str, float](), set[str]()
    for observation in observations:
        for finger, wrench in observation.wrenches.items():
            force = math.dist(wrench[:3], rig.fingers[finger].calibration.bias_force)
            largest[finger] = max(force, largest.get(finger, 0.0))
        with contextlib.suppress(HandsightError):  # joints that are missing are told of elsewhere
            touched |= set(sensors.contacts(observation).fingers)
    return [
        f"finger {finger}: never touched; a contact takes {rig.fingers[finger].tip.min_force:g} N on its tip, and the "
        f"largest force was {force:.3g} N"
        for finger, force in largest.items()
        if finger not in touched
    ]


@calibrate_app.command("camera")
def camera(recording: Recorded, rig: RigFile = None, object: ObjectName = None) -> None:
    """The camera's constant error, from the hand in its depth images, or from an object held while the palm turned.

    Where the recording has depth images and the rig the camera's intrinsics, the hand that is seen in them says where
    the camera is. Else touch: vision's error stays where it is in the world while the palm turns with the object, so
    the two come apart. Printed: the camera's corrected pose for the rig file, how well it is known, and which of both
    says so; how far they are apart where both do.
    """
    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.camera_calibration import HandViews, calibrations
    from handsight.tracking.replay import Tally

    announce_compiling()
    found, model = rig_and_object(recording, rig, object)
    tracker, tally, touched = Tracker(found, model), Tally(), None
    views = HandViews(found)
    with open_recording(recording, found) as opened, kept_going() as end:
        for each in calibrations(views.watched(opened.observations()), tracker, tally):
            touched = each
    by_vision = views.calibration()
    if touched is None and by_vision is None and isinstance(end.error, HandsightError):
        raise end.error
    _print_calibrated(by_vision, touched)
    if by_vision is None and views.images:
        say(f"the hand was hardly seen: {views.images} pictures, {_counted(views.refusals)}")
    for sentence in refusals(tally):
        say(sentence)
    if end.message:
        say(end.message)
    if end.exit_code:
        raise typer.Exit(end.exit_code)
    if touched is None and by_vision is None:
        raise InvalidInput(f"{recording}: expected an object that is held and seen, got none")


def _print_calibrated(by_vision: "HandCalibration | None", touched: "CameraCalibration | None") -> None:
    """Prints a camera's pose for the rig file, how well it is known, and from what."""
    from handsight.rig.save import pose_text
    from handsight.tracking.camera_calibration import LITTLE_TURN

    calibrated = touched if by_vision is None else by_vision
    if calibrated is None:
        return
    typer.echo(f"camera:\n  pose: {pose_text(calibrated.T_mount_camera)}")
    where = "object" if by_vision is None else "hand"
    typer.echo(
        f"# shifted by {_mm(calibrated.correction)} at the {where}, turned by {_degrees(calibrated.correction)}"
    )
    sigma = calibrated.covariance.diagonal() ** 0.5
    typer.echo(f"# known to ± {_mm(sigma)}, {_degrees(sigma)} (one standard deviation)")
    if by_vision is not None:
        views = f"{by_vision.views} of {by_vision.images} pictures"
        views += f", apart by {_mm(by_vision.spread)}, {_degrees(by_vision.spread)}"
        typer.echo(f"# from the hand seen in {views} (root mean square)")
    if touched is None:
        return
    if touched.turned < LITTLE_TURN and by_vision is None:
        reason = f"the palm turned by {math.degrees(touched.turned):.0f}° only"
        say(f"{reason}: error and pose are hardly told apart")
    if by_vision is None:
        typer.echo("# from touch")
        return
    shift, turn = touched.away_from(by_vision.T_mount_camera)
    difference = f"{1e3 * shift:.1f} mm, {math.degrees(turn):.2f}°"
    known = touched.covariance.diagonal() ** 0.5
    typer.echo(
        f"# touch says {difference} from that, at the object, and knows it to ± {_mm(known)}, {_degrees(known)}"
    )


def _mm(values: "Array") -> str:
    return "[{:.1f}, {:.1f}, {:.1f}] mm".format(*(1e3 * values[:3]))


def _degrees(values: "Array") -> str:
    return "[{:.2f}, {:.2f}, {:.2f}]°".format(*map(math.degrees, values[3:]))


def _counted(refusals: dict[str, int]) -> str:
    return ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in refusals.items()) or "too few"


def _print_rig(rig: "Rig", name: str) -> None:
    """Prints what a rig file says, in millimetres and degrees, 80 columns wide where names are short."""
    from rich.console import Console

    # Names are the user's, and [mm] is no markup.
    out = Console(markup=False, highlight=False)
    hand = rig.hand
    title = f"{name}: {len(hand.tips)} fingers on {hand.palm}, {len(hand.joint_names)} joints"
    out.print(printable(title) + "\n", soft_wrap=True)
    shapes = ("fingertip", "moves with", "shape [mm]", "cap [mm]", "friction", "± [mm]", "± [°]")
    sensors = ("sensor", "topic", "noise [mN]", "[mN m]", "range [N]", "[N m]", "tip [g]")
    style: dict[str, Any] = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
    for columns, cells in ((shapes, _shape), (sensors, _sensor)):
        rows = [list(map(printable, (finger, *cells(rig, finger)))) for finger in rig.fingers]
        out.print(table(columns, rows, texts=2, header_style="bold underline", **style), "")
    rows = [list(map(printable, row)) for row in _rows(rig)]
    out.print(table(("", ""), rows, texts=2, show_header=False, **style))


def _shape(rig: "Rig", name: str) -> list[str]:
    from handsight.contact import Sphere

    finger = rig.fingers[name]
    tip = finger.tip
    sizes = " x ".join(f"{1e3 * a:g}" for a in tip.semi_axes)
    return [
        finger.frame,
        f"sphere {1e3 * tip.radius:g}" if isinstance(tip, Sphere) else sizes,
        "whole" if tip.cap is None else f"{1e3 * tip.cap:g}",
        "any" if tip.max_friction is None else f"{tip.max_friction:g}",
        f"{1e3 * finger.sigma_point:g}",
        f"{math.degrees(finger.sigma_normal):.2g}",
    ]


def _sensor(rig: "Rig", name: str) -> list[str]:
    finger = rig.fingers[name]
    scale = ("?", "?") if finger.full_scale is None else (f"{value:g}" for value in finger.full_scale)
    return [
        rig.topics.wrenches.get(name, rig.topics.contacts.get(name, "none")),
        f"{1e3 * finger.sigma_force:g}",
        f"{1e3 * finger.sigma_torque:g}",
        *scale,
        f"{1e3 * finger.calibration.mass:g}",
    ]


def _images(camera: "MountedCamera") -> str:
    kind, lens = camera.depth_camera.replace("_", " "), len(camera.lens)
    width, height = camera.size or (0, 0)
    through = f"lens of {lens} numbers" if lens else "no lens"
    return f"{width} x {height} pixels, {through}; depth by {kind}"


def _rows(rig: "Rig") -> list[tuple[str, str]]:
    offset, noise = math.degrees(rig.sigma_joint_offset), math.degrees(rig.sigma_joint)
    places = {"tf": f"from {rig.topics.tf}", "joints": "from the joints", None: "not known"}
    rows = [
        ("joints", f"{offset:.2g}° constant, {noise:.2g}° noise; on {rig.topics.joint_states}"),
        ("palm in the world", places[rig.world_from]),
    ]
    c = rig.camera
    if c is not None:
        by_vision = f"{1e3 * c.sigma_position:g} mm, {math.degrees(c.sigma_rotation):.2g}°"
        constant = f"{1e3 * c.sigma_position_constant:g} mm, {math.degrees(c.sigma_rotation_constant):.2g}°"
        rows += [("camera", f"fixed to the {c.on}; noise {by_vision}"), ("", f"constant error {constant}")]
        rows += [("", _images(c))] if c.intrinsics is not None and c.size is not None else []
    for name, array in rig.skin.items():
        size = f"{array.rows} x {array.columns} taxels, {1e3 * array.pitch:g} mm apart"
        rows.append(
            (f"skin {name}", f"{size}, on {array.frame}; readings on {rig.topics.skin.get(name, 'nothing')}")
        )
    rows.append(("vision", f"poses on {rig.topics.vision}" if rig.topics.vision else "none"))
    if rig.table is not None:
        rows.append(("table", f"at {rig.table.height:g} m, ± {1e3 * rig.table.sigma_height:g} mm"))
    rows.append(("objects", ", ".join(rig.objects) or "none"))
    return rows
