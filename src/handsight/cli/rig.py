"""`handsight rig` and `handsight calibrate`: a first rig file, and a rig file compared with a recording."""

import contextlib
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from handsight.cli.options import ObjectName, RecordingPath, RigPath, Run, find_rig
from handsight.cli.terminal import kept_going, plain_table, print_out, say
from handsight.cli.track import latency_text, print_diagnosis, refusals
from handsight.errors import HandsightError, InvalidFile, InvalidInput, printable
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.checks import Array
    from handsight.hand.guess import GuessedTip
    from handsight.rig import Rig

rig_app = typer.Typer(
    help="Check the file that describes a robot: hand, fingertips, camera.", no_args_is_help=True
)
calibrate_app = typer.Typer(help="Estimate a robot's constant errors from a recording.", no_args_is_help=True)
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
    like: Annotated[
        str | None, Option(metavar="NAME", help="Copy the example rig of this hand, such as allegro.")
    ] = None,
) -> None:
    """Write the first rig of a hand, with a comment beside each key, to be checked and completed.

    The palm and the fingertips are guessed from the hand's file: fingers end in the last links that move, tips are
    spheres that fit the ends of their meshes. Topics are matched by the types of their messages and by their names;
    those of taxels, and a URDF's tactile sensors, give `skin`. All that was guessed is printed, and at the head of the
    file. What no file says has to be filled in: each sensor's pose, `reading` and noise, the camera's pose, the object.
    A file that exists is never overwritten.

    ```
    handsight rig new my_hand.urdf grasp.mcap
    handsight rig new --like allegro
    ```
    """
    examples = {path.name.removesuffix(".rig.yaml"): path for path in sorted(EXAMPLES.glob("*.rig.yaml"))}
    if hand is not None and like is None:
        text, name = _guessed(hand, recording), hand.stem
    elif hand is None and like is not None:
        if like not in examples:
            raise InvalidInput(f"--like: expected one of {', '.join(examples)}, got {like!r:.60}")
        text, name = examples[like].read_text(encoding="utf-8"), like
    else:
        came = "neither" if like is None else "both"
        raise InvalidInput(f"expected the hand's file, or --like and the name of an example, got {came}")
    path = output or Path(f"{name}.rig.yaml")
    with write_errors(path):
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            expected = "expected a new file, got one that exists"
            raise InvalidFile(f"{path}: {expected}; --output names another") from None
    files = f"{path}{'' if recording is None else f' {recording}'}"
    say(f"wrote {path}; next: handsight rig check {files} --plot hand.png")


def _guessed(file: Path, recording: Path | None) -> str:
    """Returns the text of a rig, with what was guessed at its head, and prints that; raises InvalidFile."""
    import numpy as np

    from handsight import se3
    from handsight.contact import Sphere, WrenchCalibration
    from handsight.hand import Hand
    from handsight.hand.guess import guess_hand
    from handsight.messages.match import match_taxels, match_topics
    from handsight.recording.open import open_files
    from handsight.rig import Finger, MountedCamera, Rig, Topics, save

    palm, tips = guess_hand(file)
    types = dict[str, str]()
    for source in open_files(recording) if recording is not None else ():
        types |= source.topics
        source.close()
    topics, used = match_topics(types, list(tips))
    skin = _skin(file, tips, match_taxels(types, list(tips)))
    if recording is None:
        topics = Topics(wrenches={name: f"/{name}/wrench" for name in tips})
    unread = WrenchCalibration(*(np.zeros(3), np.zeros(3), 0.0, np.zeros(3)), reading="on_sensor")
    fingers = dict[str, Finger]()
    for name, tip in tips.items():
        T = tip.T_link_surface
        shape = Sphere(tip.radius, cap=-tip.radius / 2, T_surface_sensor=se3.inverse(T))
        fingers[name] = Finger(frame=tip.link, T_frame_surface=T, tip=shape, calibration=unread)
    in_images = topics.vision is not None or topics.depth is not None
    rig = Rig(
        hand=Hand.from_file(file, palm=palm, tips={name: tip.link for name, tip in tips.items()}),
        fingers=fingers,
        camera=MountedCamera() if in_images else None,
        world_from="tf" if topics.tf is not None else None,
        topics=topics,
    )
    lines = [f"palm: {palm}, the last link that all fingers hang on"]
    for name, tip in tips.items():
        shape_text = f"a sphere of {1e3 * tip.radius:.1f} mm by its mesh"
        lines.append(f"finger {name}: {tip.link} is its tip, {shape_text}: measure it")
    lines += [f"topic {topic}: {what}" for topic, what in used.items()]
    lines += [f"skin {name}: of {entry.get('topic', 'a topic to fill in')}" for name, entry in skin.items()]
    if others := sorted(types.keys() - used.keys() - {entry.get("topic") for entry in skin.values()}):
        lines.append(f"not used: {', '.join(others)}")
    if topics.wrenches:
        lines.append(
            "to fill in: each sensor's pose, reading (on_sensor or on_tip), noise, bias and tip_mass"
        )
    lines.append("to fill in: the camera's pose, and objects" if in_images else "to fill in: objects")
    for line in lines:
        say(line)
    head = "".join(f"# Guessed: {line}\n" for line in lines).replace("Guessed: to fill", "To fill")
    guess = "# Each at the end of its tip, z out of the skin, y along its columns: measure, count, see docs/sensors.md"
    surfaces = [f"  {save.inline(name)}: {save.inline(entry)}" for name, entry in skin.items()]
    return head + save.text(rig) + "".join(f"{line}\n" for line in [guess, "skin:", *surfaces] if surfaces)


def _skin(
    file: Path, tips: "Mapping[str, GuessedTip]", taxels: "Mapping[str, Mapping[str, object]]"
) -> dict[str, dict[str, object]]:
    """Returns the rig's entries of tactile surfaces: those of the hand's URDF, else one at the end of each tip."""
    from handsight import se3
    from handsight.rig.layouts import tactile_sensors

    topic = {"topic": entry["topic"] for entry in taxels.values()}  # noqa: B035 - the last one
    skin = {name: {"urdf": name, "threshold": 0.1, **topic} for name in tactile_sensors(file)}
    for finger, entry in taxels.items() if not skin else ():
        T, radius = tips[finger].T_link_surface, tips[finger].radius
        end = se3.position_quaternion(T) | {"position": T[:3, 3] + radius * T[:3, 2]}
        skin[f"{finger}_tip"] = {"frame": tips[finger].link, "pose": end, **entry}
    return skin


@rig_app.command()
def check(
    rig: Annotated[Path, Argument(help="A rig file, such as rig.yaml.")],
    recording: Annotated[Path | None, Argument(help="A recording to check it against.")] = None,
    object: ObjectName = None,
    plot: Annotated[Path | None, Option(help="An image file for the hand, its tips and its taxels.")] = None,
) -> None:
    """Print a rig as tables, what a recording lacks for it, and which mistake explains what does not fit.

    With `--plot` the hand is drawn with the shapes of its tips, the sensors' axes, the palm's, the camera, and every
    taxel with its normal: those that point into a link, or hang in the air, are in a wrong place. With a recording each
    sensor whose readings cannot be used is named, with what to change: all zero, never changing, inverted, counts
    without a scale, swapped bytes.

    Where a recording contradicts itself as the rig reads it (forces that are not in balance, fingers that pull, a
    weight that is not along gravity, contacts that do not fit the object), likely mistakes are tried: forces of the
    other sign, exchanged topics, turned sensors and tips, other units, other orders of joints, another palm, a
    quaternion as w, x, y, z. The one that explains it is named, with the line to change. The measures are from 0, which
    is right, to 1.

    For a recording it also lists the fingers that never touched anything, by how much the shapes of the hand's links
    are too large (those that would be inside the object although the contacts of the fingertips fit), and what the
    recording tells of the values that the rig declares: its own estimate of each, and a verdict. Recordings in which
    the hand grasps an object again and again, in different ways, and turns and tilts it, tell most.

    ```
    handsight rig check robot.yaml --plot robot.png
    handsight rig check robot.yaml grasp.mcap --object mustard
    ```

    The exit code is 1 if the recording lacks something that tracking needs, a sensor's readings cannot be used, a
    mistake explains what does not fit, a finger was loaded but never touched, or no finger ever touched anything.
    """
    from handsight.rig import Rig
    from handsight.rig.layouts import misplaced
    from handsight.tracking.consistency import outward

    found = Rig.from_file(rig)
    _print_rig(found, str(rig))
    if plot is not None:
        from handsight.viewer.rig_figure import draw_rig

        draw_rig(found, rig.name, plot)
        say(f"wrote {plot}")
    off = misplaced(found.skin, found.hand) if found.skin else {}
    sentences = [f"skin {name}: {text}" for name, text in off.items()]
    inward = [name for name, cosine in outward(found).items() if cosine < INTO_FINGER]
    why = "the tip points into its finger: its +z must leave it (turn it by 180°)"
    sentences += [f"fingers.{name}.surface: {why}" for name in inward]
    for sentence in sentences:
        typer.echo(printable(f"- {sentence}"))
    wrong = bool(sentences)
    if recording is None:
        raise typer.Exit(int(wrong))
    run, why = None, ""
    try:
        run = Run.of(recording, rig, object)
    except InvalidInput as error:
        why = str(error)
    wrong |= _compare(found, recording, run)
    if wrong:
        raise typer.Exit(1)
    typer.echo(printable(f"{recording.name} has everything that this rig listens to."))
    if run is None:
        typer.echo(printable(f"The links' shapes and the declared values were not checked: {why}"))
    else:
        _print_values(run)


def _compare(rig: "Rig", recording: Path, run: "Run | None") -> bool:
    """Prints what a recording lacks for a rig, and which mistakes explain what is wrong; returns whether any is."""
    from handsight.messages.sensor_faults import SensorFaults
    from handsight.recording import open_recording
    from handsight.tracking.consistency import Excerpt
    from handsight.tracking.fingertips import FingertipSensors
    from handsight.tracking.mistakes import find_mistakes

    tips, sensors, excerpt = FingertipSensors(rig), SensorFaults(rig), Excerpt(rig)
    largest, touched, reasons = dict[str, float](), set[str](), Counter[tuple[str, str]]()
    with open_recording(recording, rig) as opened:
        for observation in opened.observations():
            sensors.put(observation)
            forces = {
                finger: math.dist(wrench[:3], rig.fingers[finger].calibration.bias_force)
                for finger, wrench in observation.wrenches.items()
            }
            largest |= {finger: max(force, largest.get(finger, 0.0)) for finger, force in forces.items()}
            with contextlib.suppress(HandsightError):  # missing joints are reported elsewhere
                touch = tips.contacts(observation)
                touched |= set(touch.fingers)
                for finger, reason in touch.reasons.items():
                    loaded = forces.get(finger, 0.0) > 3 * rig.fingers[finger].tip.min_force
                    reasons[finger, reason] += loaded
                excerpt.put(observation, touched=bool(touch.fingers))
        lacking = [*sensors.sentences(), *opened.report.sentences(), *opened.lacks()]
    pressed = {rig.skin[name].frame for name in sensors.touched}
    touched |= {finger for finger, of in rig.fingers.items() if of.frame in pressed}
    untouched = list[str]()
    for finger in (name for name in largest if name not in touched):
        least = f"a contact takes {rig.fingers[finger].tip.min_force:g} N on its tip"
        text = f"finger {finger}: never touched; {least}, and the largest force was {largest[finger]:.3g} N"
        counts = ((count, reason) for (name, reason), count in reasons.items() if name == finger)
        count, why = max(counts, default=(0, ""))
        if count:
            text += f": {count} readings of a load are {WHY_UNTOUCHED.get(why, why)}"
            lacking.append(text)
        else:
            untouched.append(text)
    mistakes = find_mistakes(excerpt, None if run is None else run.model)
    for sentence in (*lacking, *sensors.remarks(), *untouched, *mistakes):
        typer.echo(printable(f"- {sentence}"))
    return bool(lacking or mistakes or not touched)


def _print_values(run: "Run") -> None:
    """Prints what a recording tells of the declared values, and by how much the links' shapes are too large."""
    from handsight.tracking.diagnosis import Diagnoser
    from handsight.tracking.replay import Tally, replay

    with run.opened() as (opened, tracker):
        diagnoser = Diagnoser(tracker)
        for _ in replay(opened.observations(), tracker, Tally()):
            diagnoser.watch()
    print_diagnosis(diagnoser.diagnosis())
    for sentence in latency_text(tracker):
        typer.echo(printable(sentence))
    if not tracker.links:
        lacks = "the hand's file has no shapes" if run.model.closed else "the object has no inside"
        typer.echo(printable(f"No link keeps the object out: {lacks}."))
        return
    margins = tracker.link_margins
    rows = [(link, f"{1e3 * margins[link]:.1f}" if link in margins else "-") for link in tracker.links]
    print_out("", plain_table(("link", "shape too large by [mm]"), rows, texts=1))


@calibrate_app.command("camera")
def camera(recording: RecordingPath, rig: RigPath = None, object: ObjectName = None) -> None:
    """Estimate the camera's true pose, from the hand in its images, or from an object that the hand turned.

    If the recording has depth images and the rig has the camera's intrinsics, the pose is estimated from the hand in
    the images. Otherwise it is estimated by touch: when the palm turns with the object, the error of vision stays the
    same in the world, and can be separated from the object's pose. Printed are the corrected pose for the rig file, its
    standard deviation [mm, degrees], the source of the estimate, and, if both ways were possible, their difference.

    ```
    handsight calibrate camera turned.mcap --rig robot.yaml
    ```
    """
    from handsight.recording import open_recording
    from handsight.rig.save import pose_text
    from handsight.tracking import Tracker
    from handsight.tracking.camera_calibration import LITTLE_TURN, HandViews, calibrations
    from handsight.tracking.replay import Tally

    run = Run.of(recording, rig, object)
    tracker, tally, touched, views = Tracker(run.rig, run.model), Tally(), None, HandViews(run.rig)
    with open_recording(recording, run.rig) as opened, kept_going() as end:
        for touched in calibrations(views.watched(opened.observations()), tracker, tally):  # noqa: B007 - the last one
            pass
    by_vision = views.calibration()
    if touched is None and by_vision is None and isinstance(end.error, HandsightError):
        raise end.error
    calibrated = touched if by_vision is None else by_vision
    if calibrated is not None:
        correction, sigma = calibrated.correction, calibrated.covariance.diagonal() ** 0.5
        where = "object" if by_vision is None else "hand"
        typer.echo(f"camera:\n  pose: {pose_text(calibrated.T_mount_camera)}")
        typer.echo(f"# shifted by {_mm(correction)} at the {where}, turned by {_degrees(correction)}")
        typer.echo(f"# known to ± {_mm(sigma)}, {_degrees(sigma)} (one standard deviation)")
    if by_vision is not None:
        views_used = f"{by_vision.views} of {by_vision.images} pictures"
        views_used += f", apart by {_mm(by_vision.spread)}, {_degrees(by_vision.spread)}"
        typer.echo(f"# from the hand seen in {views_used} (root mean square)")
    elif touched is not None:
        if touched.turned < LITTLE_TURN:
            turned = f"the palm turned by {math.degrees(touched.turned):.0f}° only"
            say(f"{turned}: the camera's error and the object's pose are hardly separated")
        typer.echo("# from touch")
    if by_vision is not None and touched is not None:
        shift, turn = touched.away_from(by_vision.T_mount_camera)
        difference = f"{1e3 * shift:.1f} mm, {math.degrees(turn):.2f}°"
        known = touched.covariance.diagonal() ** 0.5
        typer.echo(f"# by touch it differs by {difference} at the object, ± {_mm(known)}, {_degrees(known)}")
    if by_vision is None and views.images:
        counts = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in views.refusals.items())
        say(f"too few images show the hand: {views.images} images, {counts or 'too few'}")
    say(*refusals(tally), *([end.message] if end.message else []))
    if end.exit_code:
        raise typer.Exit(end.exit_code)
    if touched is None and by_vision is None:
        raise InvalidInput(f"{recording}: expected an object that is held and visible, got none")


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
            off, known = (
                f"{1e3 * of.sigma_force:.0f} mN, {1e3 * of.sigma_torque:.2g} mN m" for of in (finger, was)
            )
            say(f"{name}: readings are off by {off}; the rig has {known}")


def _mm(values: "Array") -> str:
    return "[{:.1f}, {:.1f}, {:.1f}] mm".format(*(1e3 * values[:3]))


def _degrees(values: "Array") -> str:
    return "[{:.2f}, {:.2f}, {:.2f}]°".format(*map(math.degrees, values[3:]))


def _print_rig(rig: "Rig", name: str) -> None:
    """Prints a rig in millimetres and degrees, at most 80 columns wide if names are short."""
    import numpy as np

    from handsight.contact import Sphere

    hand = rig.hand
    title = f"{name}: {len(hand.tips)} fingers on {hand.palm}, {len(hand.joint_names)} joints"
    print_out(printable(title) + "\n", soft_wrap=True)
    joints = dict(zip(hand.joint_names, np.clip(0.0, *hand.limits.T).tolist(), strict=True))
    poses = dict(zip(hand.tips, hand.Ts_palm_tip(joints), strict=True))
    shapes, places, sensors = list[tuple[str, ...]](), list[tuple[str, ...]](), list[tuple[str, ...]]()
    for finger, of in rig.fingers.items():
        tip, topics = of.tip, rig.topics
        sizes = " x ".join(f"{1e3 * a:g}" for a in tip.semi_axes)
        shape = f"sphere {1e3 * tip.radius:g}" if isinstance(tip, Sphere) else sizes
        cap = "whole" if tip.cap is None else f"{1e3 * tip.cap:g}"
        friction = "any" if tip.max_friction is None else f"{tip.max_friction:g}"
        sigmas = f"{1e3 * of.sigma_point:g}", f"{math.degrees(of.sigma_normal):.2g}"
        shapes.append((finger, of.frame, shape, cap, friction, *sigmas))
        T = poses[finger] @ of.T_frame_surface
        center = ", ".join(f"{x:.1f}" for x in np.round(1e3 * T[:3, 3], 1) + 0.0)  # no -0
        along = ", ".join(f"{x:.2f}" for x in np.round(T[:3, 2], 2) + 0.0)
        places.append((finger, center, along))
        topic = topics.wrenches.get(finger, topics.contacts.get(finger, "none"))
        noise = f"{1e3 * of.sigma_force:g}", f"{1e3 * of.sigma_torque:g}"
        ranges = ("?", "?") if of.full_scale is None else (f"{value:g}" for value in of.full_scale)
        if topic != "none" or of.calibration.mass:
            sensors.append((finger, topic, *noise, *ranges, f"{1e3 * of.calibration.mass:g}"))
    for table, texts, columns in (
        (shapes, 2, ("fingertip", "moves with", "shape [mm]", "cap [mm]", "friction", "± [mm]", "± [°]")),
        (places, 1, ("with joints at 0", "centre in the palm [mm]", "points along")),
        (sensors, 2, ("sensor", "topic", "noise [mN]", "[mN m]", "range [N]", "[N m]", "tip [g]")),
    ):
        if table:
            print_out(plain_table(columns, table, texts=texts, header_style="bold underline"), "")
    constant, random = math.degrees(rig.sigma_joint_offset), math.degrees(rig.sigma_joint)
    sources = {"tf": f"from {rig.topics.tf}", "joints": "from the joints", None: "not known"}
    rows = [
        ("joints", f"{constant:.2g}° constant, {random:.2g}° noise; on {rig.topics.joint_states}"),
        ("palm in the world", sources[rig.world_from]),
    ]
    if (c := rig.camera) is not None:
        by_vision = f"{1e3 * c.sigma_position:g} mm, {math.degrees(c.sigma_rotation):.2g}°"
        always = f"{1e3 * c.sigma_position_constant:g} mm, {math.degrees(c.sigma_rotation_constant):.2g}°"
        rows += [("camera", f"fixed to the {c.on}; noise {by_vision}"), ("", f"constant error {always}")]
        if c.intrinsics is not None and c.size is not None:
            lens = f"lens of {len(c.lens)} numbers" if len(c.lens) else "no lens"
            kind = c.depth_camera.replace("_", " ")
            rows.append(("", f"{c.size[0]} x {c.size[1]} pixels, {lens}; depth by {kind}"))
    for name, array in rig.skin.items():
        topic, path = rig.topics.skin.get(name, "nothing"), rig.topics.skin_fields.get(name)
        topic = topic if path is None else f"{path} on {topic}"
        what = "pixels, cells of a gel" if array.kind == "gel" else "taxels,"
        size = f"{' x '.join(map(str, array.shape))} {what} {1e3 * array.pitch:.3g} mm apart"
        size = "touched somewhere or not" if array.kind == "binary" else size
        size += " (nominal)" if array.nominal else ""
        rows.append((f"skin {name}", f"{size}, on {array.frame}; reads {topic}"))
    rows.append(("vision", f"poses on {rig.topics.vision}" if rig.topics.vision else "none"))
    if rig.table is not None:
        rows.append(("table", f"at {rig.table.height:g} m, ± {1e3 * rig.table.sigma_height:g} mm"))
    rows.append(("objects", ", ".join(rig.objects) or "none"))
    print_out(plain_table(("", ""), rows, texts=2, show_header=False))
