"""`handsight rig` and `handsight calibrate`: a first rig file, and a rig file compared with a recording."""

import contextlib
import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from handsight.cli.options import ObjectName, RecordingPath, RigPath, Run, find_rig
from handsight.cli.terminal import kept_going, millimetres, plain_table, print_out, say
from handsight.cli.track import refusals
from handsight.errors import HandsightError, InvalidFile, InvalidInput, printable
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.checks import Array
    from handsight.hand.guess import GuessedTip
    from handsight.messages.survey import Survey
    from handsight.objects import ObjectModel
    from handsight.rig import Finger, Rig

rig_app = typer.Typer(
    help="Check the file that describes a robot: hand, fingertips, camera.", no_args_is_help=True
)
calibrate_app = typer.Typer(help="Estimate a robot's constant errors from a recording.", no_args_is_help=True)
DESCRIPTION = "/robot_description"
"""The topic on which robots say their URDF, a text."""
EXAMPLES = Path(__file__).parents[1] / "data" / "rigs"
INTO_FINGER = -0.5
"""A tip whose +z has a smaller cosine with the way from its last joint to it points into its finger."""
MOST_UNUSED = 40
"""Arrays that nothing reads which are listed in a new rig."""
NO_SENSOR = (
    "no finger has a sensor, so none can touch: fingers.X.sensor, a topic in topics.contacts, or taxels in skin on the "
    "finger's frame"
)
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
    if hand is not None:
        recording, hand = _described(hand, recording)
        text = _guessed(hand, recording, palm, taxels)
        name = hand.stem
    else:
        examples = {path.name.removesuffix(".rig.yaml"): path for path in sorted(EXAMPLES.glob("*.rig.yaml"))}
        if like not in examples:
            raise InvalidInput(f"--like: expected one of {', '.join(examples)}, got {like!r:.60}")
        text = examples[like].read_text(encoding="utf-8")
        name = like
    path = output or Path(f"{name}.rig.yaml")
    with write_errors(path):
        _new_file(path, text)
    say(f"wrote {path}; next: handsight rig check {path} {recording or ''}".rstrip())


def _described(hand: Path, recording: Path | None) -> tuple[Path | None, Path]:
    """Returns a recording and the hand's file; of a recording alone, the robot's description in it, which is written
    beside the rig. Raises InvalidFile where it has none."""
    from handsight.messages.read import deserialized
    from handsight.recording.frames import is_recording
    from handsight.recording.open import open_files

    if recording is not None or not is_recording(hand):
        return recording, hand
    for source in open_files(hand):
        with contextlib.closing(source):
            for message in source.messages({DESCRIPTION}):
                file = Path(f"{hand.stem}.urdf")
                text = str(deserialized(message).data)
                with write_errors(file):
                    _new_file(file, text)
                say(f"wrote {file}: what is said on {DESCRIPTION}")
                return hand, file
    raise InvalidFile(
        f"{hand}: expected the robot's description on {DESCRIPTION}, or the hand's file beside it, got neither"
    )


def _new_file(path: Path, text: str) -> None:
    """Writes a text to a file that is new; raises InvalidFile where there is one."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        expected = "expected a new file, got one that exists"
        raise InvalidFile(f"{path}: {expected}; --output names another") from None


def _guessed(file: Path, recording: Path | None, palm: str | None, taxels: str | None) -> str:
    """Returns the text of a rig, with what was guessed at its head, and prints that; raises InvalidFile."""
    from handsight.hand import Hand
    from handsight.hand.guess import guess_hand
    from handsight.messages.match import match_frames, match_joints, match_topics
    from handsight.messages.survey import Survey, survey
    from handsight.recording.open import open_files
    from handsight.rig import MountedCamera, Rig, Topics, save

    asked = palm is not None
    palm, tips = guess_hand(file, palm)
    hand = Hand.from_file(file, palm=palm, tips={name: tip.link for name, tip in tips.items()})
    found = Survey()
    if recording is not None:
        with contextlib.ExitStack() as opened:
            found = survey([opened.enter_context(contextlib.closing(each)) for each in open_files(recording)])
    topics, used = match_topics(found.types, list(tips))
    skin, guessed_of_skin = _skin(file, tips, found, taxels)
    lines = [] if asked else [f"palm: {palm}, the link that all fingers hang on"]
    fingers = _fingers(tips, lines)
    open_ends = list[str]()
    joint_names = dict[str, str]()
    frames = dict[str, str]()
    if recording is None:
        topics = Topics(wrenches={name: f"/{name}/wrench" for name in tips})
    else:
        stated = topics.joint_states if topics.joint_states in found.types else None
        joints = match_joints(found, hand, stated)
        joint_names = joints.joint_names
        heard_on = joints.topic or topics.joint_states
        topics = dataclasses.replace(topics, joint_states=heard_on, joint_reading=joints.reading)
        frames, guessed_of_frames, open_of_frames = match_frames(found, palm, topics.vision)
        lines += [*joints.guessed, *guessed_of_frames]
        open_ends += [*joints.open_ends, *open_of_frames]
    in_images = topics.vision is not None or topics.depth is not None
    rig = Rig(
        hand=hand,
        fingers=fingers,
        camera=MountedCamera() if in_images else None,
        world_from="tf" if topics.tf is not None else None,
        frames={"world": "world", "palm": "palm", "camera": "camera"} | frames,
        joint_names=joint_names,
        topics=topics,
    )
    lines += [f"topic {topic}: {what}" for topic, what in used.items()]
    lines += guessed_of_skin
    heard = {str(entry.get("topic")) for entry in skin.values()}
    others = found.types.keys() - used.keys() - heard - {topics.joint_states}
    if others:
        lines.append(f"not used: {', '.join(sorted(others))}")
    if not (topics.wrenches or topics.contacts or skin):
        open_ends.append(NO_SENSOR)
    if topics.wrenches:
        open_ends.append("each sensor's pose, reading (on_sensor or on_tip), noise, bias and tip_mass")
    open_ends.append("the camera's pose, and objects" if in_images else "objects")
    filled = [f"to fill in: {what}" for what in open_ends]
    say(*lines, *filled)
    head = [f"# Guessed: {line}" for line in lines] + [f"# T{line[1:]}" for line in filled]
    surfaces = [f"  {save.inline(name)}: {save.inline(entry)}" for name, entry in skin.items()]
    if surfaces:
        guess = "each at the end of its tip, z out of the skin, y along its columns: measure, count"
        surfaces = [f"# Guessed: {guess}; see docs/sensors.md", "skin:", *surfaces]
    read = {(str(entry.get("topic")), str(entry.get("field"))) for entry in skin.values()}
    if topics.joint_reading is not None:
        read.add((topics.joint_states, topics.joint_reading.field))
    unused = _unused(found, read)
    return "\n".join([*head, save.text(rig).rstrip(), *surfaces, *unused, ""])


def _fingers(tips: "Mapping[str, GuessedTip]", lines: list[str]) -> "dict[str, Finger]":
    """Returns the fingers with the tips that were guessed, and adds a line for each."""
    import numpy as np

    from handsight import se3
    from handsight.contact import Sphere, WrenchCalibration
    from handsight.rig import Finger

    unread = WrenchCalibration(np.zeros(3), np.zeros(3), 0.0, np.zeros(3), reading="on_sensor")
    fingers = dict[str, Finger]()
    for name, tip in tips.items():
        T = tip.T_link_surface
        shape = Sphere(tip.radius, cap=-tip.radius / 2, T_surface_sensor=se3.inverse(T))
        fingers[name] = Finger(frame=tip.link, T_frame_surface=T, tip=shape, calibration=unread)
        why = "by its shape" if tip.of_shape else "as the link has no shape"
        size = f"a sphere of {millimetres(tip.radius)} mm {why}: measure it"
        lines.append(f"finger {name}: {tip.link} is its tip, {size}")
    return fingers


def _unused(found: "Survey", read: set[tuple[str, str]]) -> list[str]:
    """Returns comments with the arrays in messages of drivers that nothing in the rig reads, and how they would be.

    `read`: the topics and paths of the rig.
    """
    lines = list[str]()
    known = {(topic, path.rpartition("[")[0] if ":" in path else path) for topic, path in read}
    unread = [array for at, array in found.arrays.items() if at not in known]
    arrays = [array for array in unread if array.topic in found.unknown]
    if arrays:
        lines.append(
            "# Found in messages of types that are not known here, and not used. As taxels, under skin:"
        )
        lines.append(
            '#   thumb_tip: {frame: LINK, taxels or file or layout: ..., topic: "/TOPIC", field: "PATH"}'
        )
        lines.append(
            '# As joint states, under topics: {joint_states: {topic: "/TOPIC", field: "PATH", names: [...]}}'
        )
    lines += [f"#   {array}" for array in arrays[:MOST_UNUSED]]
    if len(arrays) > MOST_UNUSED:
        lines.append(f"#   and {len(arrays) - MOST_UNUSED} more")
    for topic in sorted(found.unread):
        kind = found.types[topic]
        lines.append(f"# Not read: {topic}, as the recording lacks the definition of {kind}: record as MCAP")
    return lines


def _skin(
    file: Path, tips: "Mapping[str, GuessedTip]", found: "Survey", taxels: str | None
) -> tuple[dict[str, dict[str, object]], list[str]]:
    """Returns the rig's entries of tactile surfaces, and what was guessed of them.

    They are those of the hand's URDF, else one at the end of each tip. `taxels`: as the command's option.
    """
    from handsight import se3
    from handsight.messages.match import match_arrays, match_taxels, may_touch
    from handsight.rig.layouts import known_places, said_places, tactile_sensors

    sensors = tactile_sensors(file)
    if sensors:
        matched = match_taxels(found.types, list(sensors))
        heard = {name: {key: matched[name][key] for key in ("topic", "field")} for name in matched}
        skin = {name: {"urdf": name, "threshold": 0.1, **heard.get(name, {})} for name in sensors}
        lines = [
            f"skin {name}: of {entry.get('topic', 'a topic to fill in')}" for name, entry in skin.items()
        ]
        return skin, lines
    places, lines = (known_places(), []) if taxels is None else said_places(taxels, Path())
    touch = found.unknown | {topic for topic, kind in found.types.items() if may_touch(topic, kind)}
    arrays = [array for array in found.arrays.values() if array.topic in touch]
    entries = match_arrays(arrays, list(tips), places)
    if not entries:
        entries = match_taxels(found.types, list(tips))
        paths = {(str(entry["topic"]), str(entry["field"])) for entry in entries.values()}
        if {topic for topic, _ in paths} <= found.unknown and not paths & found.arrays.keys():
            entries = {}  # of another type of that name
    skin = {}
    for name, entry in entries.items():
        tip = tips[name.partition("_")[0]]
        T = tip.T_link_surface
        pose = se3.position_quaternion(T) | {"position": T[:3, 3] + tip.radius * T[:3, 2]}
        surface = name if "_" in name else f"{name}_tip"
        skin[surface] = {"frame": tip.link, **({} if "file" in entry else {"pose": pose}), **entry}
        of = f"{entry['field']} on {entry['topic']}"
        grid = "{rows} x {columns}".format(**entry) if "rows" in entry else "it is"
        layout = entry.get("layout") or entry.get("file") or grid
        lines.append(f"skin {surface}: {of}, by its length laid out as {layout}")
    return skin, lines


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
    mistake explains what does not fit, a finger was loaded but never touched, or no finger ever touched anything.
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
    _list(wrong)
    if recording is None:
        raise typer.Exit(int(bool(wrong)))
    model = None
    why = ""
    try:
        model = Run.of(recording, rig, object).model
    except InvalidInput as error:
        why = str(error)
    if _compare(found, recording, model) or wrong:
        raise typer.Exit(1)
    typer.echo(printable(f"{recording.name} has everything that this rig listens to."))
    if why:
        typer.echo(printable(f"The contacts were not compared with an object: {why}"))


def _list(sentences: "Iterable[str]") -> None:
    for sentence in sentences:
        typer.echo(printable(f"- {sentence}"))


def _compare(rig: "Rig", recording: Path, model: "ObjectModel | None") -> bool:
    """Prints what a recording lacks for a rig, and which mistakes explain what is wrong; returns whether any is."""
    from handsight.messages.sensor_faults import SensorFaults
    from handsight.recording import open_recording
    from handsight.tracking.fingertips import FingertipSensors
    from handsight.tracking.mistakes import Excerpt, find_mistakes

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
        _list(lacking)
        return True
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
    mistakes, unexplained = find_mistakes(excerpt, model)
    on_tips = {array.frame for array in rig.skin.values()} & {of.frame for of in rig.fingers.values()}
    if not (rig.topics.wrenches or rig.topics.contacts or on_tips):
        lacking.append(NO_SENSOR)
    elif not (touched or lacking or untouched):
        lacking.append("no finger ever touched anything")
    _list([*lacking, *sensors.remarks(), *untouched, *mistakes, *filter(None, [unexplained])])
    return bool(lacking or mistakes or not touched)


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
    from handsight.recording import open_recording
    from handsight.rig.save import pose_text
    from handsight.tracking import Tracker
    from handsight.tracking.camera_calibration import LITTLE_TURN, HandViews, calibrations
    from handsight.tracking.replay import Tally

    run = Run.of(recording, rig, object)
    tracker = Tracker(run.rig, run.model)
    tally = Tally()
    views = HandViews(run.rig)
    touched = None
    with open_recording(recording, run.rig) as opened, kept_going() as end:
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
