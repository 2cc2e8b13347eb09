"""What is wrong with a rig file is told with file, line, path, what was expected, and what came."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from handsight.errors import InvalidFile, InvalidInput
from handsight.rig import Rig
from handsight.rig.yaml_file import MAX_BYTES, MAX_NAME_LENGTH, MAX_VALUES
from rig.rigs import URDF, full, rig_text
from testbed.refusals import refused


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rigs")


@pytest.fixture(scope="module")
def text(folder):
    return rig_text(folder)


def said_of(folder, content):
    """What is said of a file's content, without the file's name; no line is 0."""
    path = folder / "rig.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidFile) as error:
        Rig.from_file(path)
    message = str(error.value)
    assert message.startswith(f"{path}:")
    line, _, rest = message.removeprefix(f"{path}:").partition(": ")
    return (int(line), rest) if line.isdigit() else (0, message.removeprefix(f"{path}: "))


# What is replaced by what (its first occurrence), and which field and hint are told at that line.
MISTAKES = [
    ("sigma_height", "sigma_heigth", "table.sigma_heigth", "nearest valid one is"),
    ("position: 0.1,", "postion: 0.1,", "camera.noise.postion", "nearest valid one is"),
    ("table:", "tabel:", "tabel", "nearest valid one is"),
    ("truth: ", "thruth: ", "topics.thruth", "nearest valid one is"),
    ('world: "map"', 'earth: "map"', "frames.earth", ""),
    ("version: 1", "version: 2", "version", ""),
    ("version: 1", "version: one", "version", ""),
    ("\nfingers:", "\nfigners:", "figners", "nearest valid one is"),
    ("\nfingers:", "\nfingers: 5\nfigners:", "fingers", ""),
    ("\nfingers:", "\nfingers: [a]\nfigners:", "fingers", ""),
    ('palm: "palm"', 'palm: "plam"', "hand.palm", "nearest valid one is"),
    ('palm: "palm"', "palm: [palm]", "hand.palm", ""),
    ('palm: "palm"', "palm: ' '", "hand.palm", ""),
    ("thumb_tip", "thumbtip", "fingers.thumb.frame", "nearest valid one is"),
    ("joint_offset_deg: ", "joint_offset_deg: '1' #", "hand.joint_offset_deg", ""),
    ("joint_offset_deg: ", "joint_offset_deg: -1 #", "hand.joint_offset_deg", ""),
    ("joint_offset_deg: ", "joint_offset_deg: .nan #", "hand.joint_offset_deg", ""),
    ("joint_offset_deg: ", f"joint_offset_deg: 0x{'f' * 5000} #", "hand.joint_offset_deg", ""),
    ("  height: ", "  height: true #", "table.height", ""),
    ("  height: ", "  height: 0 mm #", "table.height", ""),
    ("sigma_height: ", "sigma_height: 0 #", "table.sigma_height", ""),
    ("tip_mass: ", "tip_mass: 4 #", "fingers.index.sensor.tip_mass", "(grams?)"),
    ("surface: {position: [", "surface: {position: [16.5e+3, 0, 0]} #", "fingers.index.surface.position", "(millimetres?)"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [9, 9, 14.5]", "fingers.index.tip.ellipsoid", "(millimetres? 0.009 m)"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [0.009, true, 0.02]", "fingers.index.tip.ellipsoid[1]", ""),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [0.009, '0.01', 0.02]", "fingers.index.tip.ellipsoid[1]", ""),
    ("ellipsoid: [0.009, 0.01, 0.02]", "elipsoid: [0.009, 0.01, 0.02]", "fingers.index.tip.elipsoid", "nearest valid one is"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "sphere: 1, ellipsoid: [1, 1, 1]", "fingers.index.tip", ""),
    ("surface: {position: [", "surface: {position: [0, 0, 16.5]} #", "fingers.index.surface.position", "(millimetres? [0, 0, 0.0165] m)"),
    ("tip_center: ", "tip_center: [0, 0, 14.5] #", "fingers.index.sensor.tip_center", "(millimetres? [0, 0, 0.0145] m)"),
    ("sigma_point: ", "sigma_point: 5 #", "fingers.index.sigma_point", "(millimetres? 0.005 m)"),
    ("sigma_normal_deg: ", "sigma_normal_deg: 200 #", "fingers.index.sigma_normal_deg", ""),
    ("{position: 0.1,", "{position: 64,", "camera.noise.position", "(millimetres? 0.064 m)"),
    ("  height: ", "  height: 750 #", "table.height", "(millimetres? 0.75 m)"),
    ("{radius: 0.1,", "{radius: 33,", "objects.tin.cylinder.radius", "(millimetres? 0.033 m)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [60, 90, 140]}", "objects.a box.box", "(millimetres? [0.06, 0.09, 0.14] m)"),
    ("bias: {force: [", "bias: {force: [1.0e+9, 0, 0]} #", "fingers.index.sensor.bias.force", ""),
    ("thumb_tip", "index_tip", "fingers.thumb.frame", ""),
    ('"thumb": "/b: c"', '"thumb": "/a"', "topics.wrenches.thumb", ""),
    ('truth: "/t"', 'truth: "/see"', "topics.truth", ""),
    ("full_scale: [30, 0.7]", "full_scale: [30, 0]", "fingers.index.sensor.full_scale[1]", ""),
    ("reading: on_sensor", "reading: on_senser", "fingers.index.sensor.reading", "nearest valid one is"),
    ("fixed_to: palm", "fixed_to: wrist", "camera.fixed_to", ""),
    ("depth_camera: stereo", "depth_camera: steroe", "camera.depth_camera", "nearest valid one is"),
    ("  lens: [", "  lens: [0.1, 0.2] # [", "camera.lens", ""),
    ("  lens: [", "  lens: [a, 0, 0, 0] # [", "camera.lens[0]", ""),
    ("  lens: [", "  lens: 0.1 # [", "camera.lens", ""),
    ("  lens: [", "  lense: [", "camera.lense", "nearest valid one is"),
    ("  intrinsics: {", "  #", "camera.lens", ""),
    ("palm_from: joints", "palm_from: sky", "world.palm_from", ""),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: [0, 0, -981]", "world.gravity", ""),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: [0, 0]", "world.gravity", ""),
    ('"index": "/a"', '"indx": "/a"', "topics.wrenches.indx", "nearest valid one is"),
    ("{box: [0.1,", "{box: [-0.1,", "objects.a box.box[0]", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{boks: [1, 1, 1]}", "objects.a box.boks", "nearest valid one is"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mesh: a.stl}", "objects.a box", ""),
    ("{radius: 0.1,", "{radios: 0.1,", "objects.tin.cylinder.radios", "nearest valid one is"),
    ("{radius: 0.1,", "{", "objects.tin.cylinder.radius", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{}", "objects.a box", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mass: 150}", "objects.a box.mass", "(grams?)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mass: 0}", "objects.a box.mass", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0, 30]}", "objects.a box.center_of_mass", "(millimetres? [0, 0, 0.03] m)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: homogenous}", "objects.a box.center_of_mass", "nearest valid one is"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0]}", "objects.a box.center_of_mass", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0, .nan]}", "objects.a box.center_of_mass[2]", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], sigma_center_of_mass: 0.001}", "objects.a box.sigma_center_of_mass", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], sigma_mass: 0.001}", "objects.a box.sigma_mass", ""),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], scale: 2}", "objects.a box.scale", ""),
    ("ellipsoid: [0.009, 0.01, 0.02], ", "", "fingers.index.tip", ""),
    ("surface: {position: [", "surface: {quaternion_xyzw: [0, 0, 0, 0]} #", "fingers.index.surface.quaternion_xyzw", ""),
    ('"index": "/a"', '"index": [1]', "topics.wrenches.index", ""),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: 9.81", "world.gravity", ""),
    ("scale: 0.004}", "scale: 0}", "objects.mug.scale", ""),
    ("pinch.urdf", "none.urdf", "hand.file", ""),
    ("pinch.urdf", "a" * 300, "hand.file", ""),
    ("version: 1", "version: 1\nversion: 1", "", ""),
    ("version: 1", "1: 2\nversion: 1", "file", ""),
    ("hand:", "hand: !!python/object:os.system", "hand", ""),
    ("joint_offset_deg: ", "joint_offset_deg: !!python/name:os.system 3 #", "hand.joint_offset_deg", ""),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "field", "hint"), MISTAKES)
def test_a_mistake_is_reported_at_its_line(folder, text, old, new, field, hint):
    assert old in text
    line, message = said_of(folder, text.replace(old, new, 1))
    assert message.startswith(f"{field}: " if field else "expected ")
    assert hint in message
    assert re.search("expected .*got|unknown", message)
    at = text[: text.index(old)].count("\n") + 1
    # A key and what is missing are told at the mapping they are in.
    assert at - 2 <= line <= at + 1


@pytest.mark.parametrize("section", ["version", "hand", "fingers"])
def test_what_cannot_be_left_out_is_named_where_its_name_is_misspelt_and_where_it_is_not_there(
    folder, text, section
):
    line, message = said_of(folder, text.replace(f"\n{section}:", f"\nx{section}:", 1))
    assert line == text[: text.index(f"\n{section}:")].count("\n") + 2
    assert message.startswith(f"x{section}: unknown key")
    assert repr(section) in message
    needed = {
        "version": "version: 1",
        "hand": "hand: {file: pinch.urdf, palm: palm}",
        "fingers": "fingers: {}",
    }
    message = said_of(folder, "\n".join(value for name, value in needed.items() if name != section))[1]
    assert message.startswith(f"{section}: expected")


def test_two_tips_at_one_place_are_refused_and_so_is_one_finger_twice_in_python(folder):
    urdf = URDF.replace("</robot>", '<link name="pad"/>{}</robot>').format(
        '<joint name="glue" type="fixed"><parent link="index_tip"/><child link="pad"/></joint>'
    )
    (folder / "glued.urdf").write_text(urdf)
    finger = "{{frame: {}, tip: {{sphere: 0.01}}, sensor: {{reading: on_tip}}}}"
    text = "version: 1\nhand: {file: glued.urdf, palm: palm}\nfingers:\n"
    text += f"  a: {finger.format('index_tip')}\n  b: {finger.format('pad')}\n"
    line, message = said_of(folder, text)
    assert (line, message.partition(": ")[0]) == (5, "fingers.b.surface")
    rig = full(folder)
    index = rig.fingers["index"]
    with refused(InvalidInput, "fingers['thumb'].frame"):
        replace(rig, fingers={"index": index, "thumb": index})
    with refused(InvalidInput, "topics.truth"):
        replace(rig, topics=replace(rig.topics, truth="/see"))
    with refused(InvalidInput, "sigma_point"):
        replace(index, sigma_point=-1.0)


@pytest.mark.parametrize("wrong", ["/nowhere: 1.0", "/a: .nan", "/a: true"])
def test_an_offset_of_no_topic_or_that_is_no_number_is_told_at_its_line(folder, text, wrong):
    spoilt = re.sub("  offsets:.*\n(    .*\n)*", f"  offsets: {{{wrong}}}\n", text)
    line, message = said_of(folder, spoilt)
    assert spoilt.splitlines()[line - 1].startswith("  offsets:")
    assert message.startswith("topics.offsets")


def test_a_rig_without_fingers_is_reported(folder):
    text = "version: 1\nhand: {file: pinch.urdf, palm: palm}\nfingers: {}\n"
    line, message = said_of(folder, text)
    assert (line, message.partition(": ")[0]) == (3, "fingers")


@pytest.mark.parametrize(
    "content",
    [
        "", "- a\n", "hello", b"\xff\xfe\x00", b"version: 1 # \xe9", "#" * (MAX_BYTES + 1), "version: [1",
        "version: 1\n---\nversion: 1", "[" * 1000, "- " * 400 + "1", "a: [" + "1," * MAX_VALUES,
        "a: 1\n" * (MAX_VALUES + 1), "a: &a\n  <<: *a\n  b: 1\n", "a: " + "9" * 5000, "version: \0",
        "? [a]\n: 1\n", "version: *a",
    ],
    ids=lambda content: repr(content[:20]),
)  # fmt: skip
def test_what_is_no_rig_is_reported(folder, content):
    _, message = said_of(folder, content)
    assert message.removeprefix("file: ").startswith("expected ")


def test_a_long_name_is_cut(folder):
    _, message = said_of(folder, "version: 1\n" + "x" * 900 + ": 1\n")
    assert message.startswith("x" * MAX_NAME_LENGTH + ": unknown key")


def test_a_few_lines_that_stand_for_billions_are_refused_at_once(folder):
    lines = ["a: &a [1, 2]"]
    for last, name in zip("abcdefghijkl", "bcdefghijklm", strict=True):
        lines.append(f"{name}: &{name} [{', '.join([f'*{last}'] * 10)}]")
    _, message = said_of(folder, "\n".join(lines))
    assert f"at most {MAX_VALUES} values" in message


def test_no_file_is_reported(folder):
    with refused(InvalidFile, "none.yaml"):
        Rig.from_file(folder / "none.yaml")
    with refused(InvalidFile, folder.name):
        Rig.from_file(folder)
    if Path("/dev/zero").exists():
        with refused(InvalidFile, "zero"):
            Rig.from_file("/dev/zero")
    with refused(InvalidInput, "path"):
        Rig.from_file(5)
