"""`handsight rig` and `handsight calibrate`: a first rig file, and a rig file compared with a recording."""

import contextlib
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from typer import Argument, Option

from handsight.cli.options import ObjectName, RecordingPath, RigPath, Run, find_rig
from handsight.cli.terminal import FAILED, kept_going, millimetres, plain_table, print_out, say
from handsight.cli.track import refusals
from handsight.errors import HandsightError, InvalidFile, InvalidInput, InvalidObject, printable
from handsight.files import text_file

if TYPE_CHECKING:
    from handsight.checks import Array
    from handsight.messages.survey import Survey
    from handsight.objects import ObjectModel
    from handsight.rig import Finger, Rig
    from handsight.tracking import Tracker

rig_app = typer.Typer(
    help="Check the file that describes a robot: hand, fingertips, camera.", no_args_is_help=True
)
calibrate_app = typer.Typer(help="Estimate a robot's constant errors from a recording.", no_args_is_help=True)
DESCRIPTION = "/robot_description"
"""The topic on which robots say their URDF, a text."""
EXAMPLES = Path(__file__).parents[1] / "data" / "rigs"
INTO_FINGER = -0.5
"""A tip whose +z has a smaller cosine with the way from its last joint to it points into its finger."""
WHY_UNTOUCHED = {
    "off_cap": "beside the sensed part of its tip: cap, surface, sensor.pose or reading is wrong",
    "beyond_friction": "of more friction than its tip's max_friction: bias, sensor.pose or max_friction is wrong",
}


@rig_app.command()
def new(
    hand: Annotated[Path | None, Argument(help="The hand's URDF or MJCF.")] = None,
    recording: Annotated[Path | None, Argument(help="A recording, whose topics the rig is to have.")] = None,
    output: Annotated[
        Path | None, Option("--output", "-o", help="File for the rig. Default: HAND.rig.yaml in this folder.")
    ] = None,
    palm: Annotated[
        str | None,
        Option(metavar="LINK", help="The palm's link, where the file is of a robot with several hands."),
    ] = None,
    taxels: Annotated[
        str | None,
        Option(
            metavar="NUMBER|FILE",
            help="The taxels of a tip that is of no known product: their number, or the maker's table of places.",
        ),
    ] = None,
    like: Annotated[
        str | None, Option(metavar="NAME", help="Copy the example rig of this hand, such as allegro.")
    ] = None,
) -> None:
    """Write the first rig of a hand, with a comment beside each key, to be checked and completed.

    The palm and the fingertips are guessed from the hand's file: fingers end in the last links that move, tips are
    spheres that fit the ends of their meshes. Topics are matched by the types of their messages and by their names;
    those of taxels, and a URDF's tactile sensors, give `skin`. In messages of types that are not known here, arrays as
    long as a product's taxels, or those of `--taxels`, are taken for taxels, and arrays with the joints' names, or as
    many numbers, for joint states; names of joints and frames are the messages'. All that was guessed is printed, and
    at the head of the file; what else is in such messages is in comments at its end. What no file says has to be filled
    in: each sensor's pose, `reading` and noise, the camera's pose, the object.
    A file that exists is never overwritten.

    ```
    handsight rig new my_hand.urdf grasp.mcap
    handsight rig new robot.urdf --palm left_palm
    handsight rig new grasp.mcap                     # with /robot_description in it
    handsight rig new my_hand.urdf grasp.mcap --taxels tip.csv
    handsight rig new --like allegro
    ```
    """
    if (hand is None) == (like is None):
        came = "neither" if like is None else "both"
        raise InvalidInput(f"expected the hand's file, or --like and the name of an example, got {came}")
    from handsight.messages.first_rig import first_rig

    with contextlib.ExitStack() as undone:
        if hand is not None:
            recording, hand = _described(hand, recording, undone)
            found = None if recording is None else _surveyed(recording)
            said, text = first_rig(hand, found, palm=palm, taxels=taxels)
            say(*said)
            name = hand.stem
        else:
            examples = {path.name.removesuffix(".rig.yaml"): path for path in EXAMPLES.glob("*.rig.yaml")}
            if like not in examples:
                raise InvalidInput(f"--like: expected one of {', '.join(sorted(examples))}, got {like!r:.60}")
            text = examples[like].read_text(encoding="utf-8")
            name = like
        path = output or Path(f"{name}.rig.yaml")
        _new_file(path, text)
        undone.pop_all()
    say(f"wrote {path}; next: handsight rig check {path} {recording or ''}".rstrip())


def _described(hand: Path, recording: Path | None, undone: contextlib.ExitStack) -> tuple[Path | None, Path]:
    """Returns a recording and the hand's file; of a recording alone, the robot's description in it, which is written
    beside the rig, and taken away when `undone` ends. Raises InvalidFile where it has none."""
    from handsight.messages.read import deserialized
    from handsight.recording.frames import is_recording
    from handsight.recording.open import open_files

    if recording is not None or not is_recording(hand):
        return recording, hand
    for source in open_files(hand):
        with contextlib.closing(source):
            for message in source.messages({DESCRIPTION}):
                file = Path(f"{hand.stem}.urdf")
                _new_file(file, str(deserialized(message).data))
                undone.callback(file.unlink)
                say(f"wrote {file}: what is said on {DESCRIPTION}")
                return hand, file
    raise InvalidFile(
        f"{hand}: expected the robot's description on {DESCRIPTION}, or the hand's file beside it, got neither"
    )


def _new_file(path: Path, text: str) -> None:
    """Writes a text to a file that is new; raises InvalidFile where there is one, NotWritten."""
    if path.exists():
        expected = "expected a new file, got one that exists"
        raise InvalidFile(f"{path}: {expected}; --output names another")
    with text_file(path) as file:
        file.write(text)


def _surveyed(recording: Path) -> "Survey":
    """Returns what is in a recording's messages."""
    from handsight.messages.survey import survey
    from handsight.recording.open import open_files

    with contextlib.ExitStack() as opened:
        return survey([opened.enter_context(contextlib.closing(each)) for each in open_files(recording)])


@rig_app.command()
def check(
    rig: Annotated[Path, Argument(help="A rig file, such as rig.yaml.")],
    recording: Annotated[Path | None, Argument(help="A recording to check it against.")] = None,
    object: ObjectName = None,
) -> None:
    """Print where a rig's parts are, what a recording lacks for it, and which mistake explains what does not fit.

    Taxels whose normals point into a link, or that hang in the air, are in a wrong place. With a recording each
    sensor whose readings cannot be used is named, with what to change: all zero, never changing, inverted, counts
    without a scale, swapped bytes.

    Where a recording contradicts itself as the rig reads it (forces that are not in balance, fingers that pull, a
    weight that is not along gravity, contacts that do not fit the object), likely mistakes are tried: forces of the
    other sign, exchanged topics, tips along another axis, other units, other orders of joints, a quaternion as w, x,
    y, z, a camera in another of its frames, gravity the other way, taxels and their axes turned. The one that explains
    it is named, with the line to change; where none does, that is said. The measures are from 0, which is right, to 1.

    For a recording it also lists the fingers that never touched anything. What a recording tells of the values that
    the rig declares stands in a table at the end of `handsight track`.

    ```
    handsight rig check robot.yaml
    handsight rig check robot.yaml grasp.mcap --object mustard
    ```

    The exit code is 1 if the recording lacks something that tracking needs, a sensor's readings cannot be used, a
    mistake explains what does not fit, a finger was loaded but never touched, or no finger ever touched anything: each
    is a line that begins with a dash. Lines that begin with `note:` do not change it.
    """
    from handsight.rig import Rig
    from handsight.rig.layouts import misplaced
    from handsight.rig.outward import outward

    found = Rig.from_file(rig)
    _print_rig(found, str(rig))
    off = misplaced(found.skin, found.hand) if found.skin else {}
    wrong = [f"skin {name}: {text}" for name, text in off.items()]
    for name, cosine in outward(found).items():
        if cosine < INTO_FINGER:
            why = "the tip points into its finger: its +z must leave it (turn it by 180°)"
            wrong.append(f"fingers.{name}.surface: {why}")
    if recording is None:
        _end(wrong)
        return
    model = None
    notes = list[str]()
    try:
        model = Run.of(recording, rig, object).model
    except InvalidObject as error:
        wrong.append(str(error))
    except InvalidInput as error:
        notes.append(f"the contacts were not compared with an object: {error}")
    compared = _compare(found, recording, model)
    _end(wrong + compared.wrong, compared.notes + notes)
    typer.echo(printable(f"{recording.name} has everything that this rig listens to."))


@rig_app.command()
def schema() -> None:
    """Print every key of a rig file as Markdown: its values, its bounds, and what it means.

    ```
    handsight rig schema
    ```
    """
    from handsight.rig.schema import schema as reference

    typer.echo(reference(), nl=False)


def _end(wrong: "Sequence[str]", notes: "Sequence[str]" = ()) -> None:
    """Prints what must be changed, and notes, which need not be; ends the command where there is something wrong."""
    for sentence in wrong:
        typer.echo(printable(f"- {sentence}"))
    for sentence in notes:
        typer.echo(printable(f"note: {sentence}"))
    if wrong:
        raise typer.Exit(FAILED)


class Compared(NamedTuple):
    """What a recording tells of a rig."""

    wrong: list[str]
    """What must be changed, in sentences."""
    notes: list[str]
    """What a user may want to know."""


def _compare(rig: "Rig", recording: Path, model: "ObjectModel | None") -> Compared:
    """Returns what a recording lacks for a rig, which mistakes explain what is wrong, and what is only noted."""
    from handsight.messages.first_rig import NO_SENSOR
    from handsight.messages.sensor_faults import SensorFaults
    from handsight.recording import open_recording
    from handsight.tracking.consistency import Excerpt
    from handsight.tracking.fingertips import FingertipSensors
    from handsight.tracking.mistakes import find_mistakes

    tips = FingertipSensors(rig)
    sensors = SensorFaults(rig)
    excerpt = Excerpt(rig)
    largest = dict[str, float]()
    touched = set[str]()
    placed = False  # whether the joints' positions were ever known
    reasons = {finger: Counter[str]() for finger in rig.fingers}  # why loads are no contacts
    with open_recording(recording, rig) as opened:
        for observation in opened.observations():
            sensors.put(observation)
            forces = {}
            for finger, wrench in observation.wrenches.items():
                forces[finger] = math.dist(wrench[:3], rig.fingers[finger].calibration.bias_force)
                largest[finger] = max(forces[finger], largest.get(finger, 0.0))
            with contextlib.suppress(HandsightError):  # missing joints are reported elsewhere
                touch = tips.contacts(observation)
                placed = True
                touched |= set(touch.fingers)
                for finger, reason in touch.reasons.items():
                    if forces.get(finger, 0.0) > 3 * rig.fingers[finger].tip.min_force:
                        reasons[finger][reason] += 1
                excerpt.put(observation, touched=bool(touch.fingers))
        lacking = [*opened.lacks(), *sensors.sentences(), *opened.report.sentences()]
    if not placed:  # what follows from that is not said
        return Compared(lacking, [])
    pressed = {rig.skin[name].frame for name in sensors.touched}
    touched |= {finger for finger, of in rig.fingers.items() if of.frame in pressed}
    untouched = list[str]()
    for finger in sorted(largest.keys() - touched):
        least = f"a contact takes {rig.fingers[finger].tip.min_force:g} N on its tip"
        text = f"finger {finger}: never touched; {least}, and the largest force was {largest[finger]:.3g} N"
        untouched.append(text)
        for why, count in reasons[finger].most_common(1):
            untouched.pop()
            lacking.append(f"{text}: {count} readings of a load are {WHY_UNTOUCHED.get(why, why)}")
    explained, unexplained = find_mistakes(excerpt, model)
    mistakes = [str(each) for each in explained]
    on_tips = {array.frame for array in rig.skin.values()} & {of.frame for of in rig.fingers.values()}
    if not (rig.topics.wrenches or rig.topics.contacts or on_tips):
        lacking.append(NO_SENSOR)
    elif not (touched or lacking or untouched):
        lacking.append("no finger ever touched anything")
    notes = [*sensors.remarks(), *filter(None, [unexplained])]
    if touched:
        return Compared([*lacking, *mistakes], [*notes, *untouched])
    return Compared([*lacking, *untouched, *mistakes], notes)


@calibrate_app.command("camera")
def camera(recording: RecordingPath, rig: RigPath = None, object: ObjectName = None) -> None:
    """Estimate the camera's true pose, from the hand in its images, or from an object that the hand turned.

    If the recording has depth images and the rig has the camera's intrinsics, the pose is estimated from the hand in
    the images. Otherwise it is estimated by touch: when the palm turns with the object, the error of vision stays the
    same in the world, and can be separated from the object's pose. Printed are the corrected pose for the rig file, its
    standard deviation [mm, degrees], and the source of the estimate.

    ```
    handsight calibrate camera turned.mcap --rig robot.yaml
    ```
    """
    from handsight.rig.save import pose_text
    from handsight.tracking.camera_calibration import LITTLE_TURN, HandViews, calibrations
    from handsight.tracking.replay import Tally

    run = Run.of(recording, rig, object)
    tally = Tally()
    touched = None
    with run.opened() as (opened, tracker), kept_going() as end:
        views = HandViews(tracker.rig)
        for touched in calibrations(views.watched(opened.observations()), tracker, tally):  # noqa: B007 - the last one
            pass
    seen = views.calibration()
    found = seen or touched
    if found is None and isinstance(end.error, HandsightError):
        raise end.error
    if found is not None:
        typer.echo(f"camera:\n  pose: {pose_text(found.T_mount_camera)}")
        where = "object" if seen is None else "hand"
        typer.echo(f"# shifted and turned, at the {where}, by {_pose_text(found.correction)}")
        sigmas = _pose_text(found.covariance.diagonal() ** 0.5)
        typer.echo(f"# known to ± {sigmas} (one standard deviation)")
    if seen is not None:
        typer.echo(f"# from the hand seen in {seen.views} of {seen.images} pictures")
    elif touched is not None:
        typer.echo("# from touch")
        if touched.turned < LITTLE_TURN:
            turned = f"the palm turned by {math.degrees(touched.turned):.0f}° only"
            say(f"{turned}: the camera's error and the object's pose are hardly separated")
    if seen is None and views.images:
        counts = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in views.refusals.items())
        say(f"too few images show the hand: {views.images} images, {counts or 'too few'}")
    say(*refusals(tally), *filter(None, [end.message]))
    if end.exit_code:
        raise typer.Exit(end.exit_code)
    if found is None:
        raise InvalidInput(f"{recording}: {_why_no_camera(tracker)}")


def _why_no_camera(tracker: "Tracker") -> str:
    """Returns why the camera of a recording could not be calibrated."""
    camera = tracker.rig.camera
    topics = tracker.rig.topics
    if camera is not None and camera.intrinsics is None and topics.vision is None:
        info = "no CameraInfo" if topics.camera_info is None else f"no CameraInfo on {topics.camera_info}"
        return f"expected the camera's intrinsics in the rig or the recording, got {info}"
    held = "expected an object that is held and visible, got none"
    return f"{held}: {tracker.reason}" if tracker.reason else held


@calibrate_app.command("sensors")
def sensors(recording: RecordingPath, rig: RigPath = None) -> None:
    """Estimate bias, tip mass and noise of the fingertips' force/torque sensors, from a hand that touches nothing.

    The hand must have been still in several orientations, six that are as different as possible at best. Printed are
    the lines of the rig file that change. The noise is what the calibration leaves, if that is more than the noise of
    single readings: a bias that depends on the direction of gravity is no noise, but an error all the same.

    ```
    handsight calibrate sensors turned_in_the_air.mcap --rig robot.yaml
    ```
    """
    from handsight.forces import calibrate_sensors
    from handsight.recording import open_recording
    from handsight.rig.save import sensor_text

    before, _ = find_rig(recording, rig)
    with open_recording(recording, before) as opened:
        after = calibrate_sensors(before, opened.observations())
    typer.echo("fingers:")
    for name, finger in after.fingers.items():
        for line in (f"  {name}:", "    sensor:", *(f"      {line}" for line in sensor_text(finger))):
            typer.echo(printable(line))
        was = before.fingers[name]
        if finger.sigma_force > was.sigma_force or finger.sigma_torque > was.sigma_torque:
            say(f"{name}: readings are off by {_noise_text(finger)}; the rig has {_noise_text(was)}")


def _noise_text(finger: "Finger") -> str:
    return f"{1000 * finger.sigma_force:.0f} mN, {1000 * finger.sigma_torque:.2g} mN m"


def _pose_text(values: "Array") -> str:
    """Returns the text of a shift [m] and a turn [rad] (6,)."""
    turn = ", ".join(f"{math.degrees(value):.2f}" for value in values[3:])
    return f"[{millimetres(values[:3])}] mm, [{turn}]°"


def _print_rig(rig: "Rig", name: str) -> None:
    """Prints what a rig's file does not show by itself: where its parts are with joints at 0, and what they read."""
    import numpy as np

    hand = rig.hand
    title = f"{name}: {len(hand.tips)} fingers on {hand.palm}, {len(hand.joint_names)} joints"
    print_out(printable(title) + "\n", soft_wrap=True)
    at_zero = dict(zip(hand.joint_names, np.clip(0.0, *hand.limits.T).tolist(), strict=True))
    poses = dict(zip(hand.tips, hand.Ts_palm_tip(at_zero), strict=True))
    rows = []
    for finger, of in rig.fingers.items():
        T = poses[finger] @ of.T_frame_surface
        along = ", ".join(f"{x:.2f}" for x in np.round(T[:3, 2], 2) + 0.0)  # no -0
        own = [name for name, array in rig.skin.items() if array.frame == of.frame]
        heard = [rig.topics.wrenches.get(finger), rig.topics.contacts.get(finger)]
        topic = ", ".join([*filter(None, heard), *(f"skin {name}" for name in own)]) or "nothing"
        rows.append((finger, of.frame, millimetres(T[:3, 3]), along, topic))
    columns = ("fingertip", "moves with", "at [mm]", "points along", "reads")
    print_out(plain_table(columns, rows, texts=5, header_style="bold underline"), "")
    others = []
    for surface, array in rig.skin.items():
        topic = rig.topics.skin.get(surface, "nothing")
        if path := rig.topics.skin_fields.get(surface):
            topic = f"{path} on {topic}"
        shape = " x ".join(map(str, array.shape))
        size = f"{shape}, {1000 * array.pitch:.3g} mm apart{' (nominal)' * array.nominal}"
        others.append((f"skin {surface}", f"{size}, on {array.frame}; reads {topic}"))
    camera = rig.camera
    if camera is not None:
        size = "without intrinsics" if camera.size is None else "{} x {} pixels".format(*camera.size)
        kind = camera.depth_camera.replace("_", " ")
        others.append(("camera", f"on the {camera.on}; {size}; depth by {kind}"))
    others.append(("objects", ", ".join(rig.objects) or "none"))
    print_out(plain_table(("", ""), others, texts=2, show_header=False))
