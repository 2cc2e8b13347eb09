"""What is wrong with a rig file is told with file, line, path, what was expected, and what came."""

import random
from dataclasses import replace
from pathlib import Path

import pytest

from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.rig import Rig
from handsight.rig.yaml_file import MAX_BYTES, MAX_NAME_LENGTH, MAX_VALUES
from rig.rigs import URDF, full, rig_text

TOO_MANY = f"expected at most {MAX_VALUES} values, got more (aliases of aliases?)"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rigs")


@pytest.fixture(scope="module")
def text(folder):
    return rig_text(folder)


def refused(folder, content):
    """What is said of a file's content, without the file's name; no line is 0."""
    path = folder / "rig.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidFile) as error:
        Rig.from_file(path)
    message = str(error.value)
    assert message.startswith(f"{path}:")
    line, _, rest = message.removeprefix(f"{path}:").partition(": ")
    return (int(line), rest) if line.isdigit() else (0, message.removeprefix(f"{path}: "))


# What is replaced by what (its first occurrence), and what is said at that line.
MISTAKES = [
    ("sigma_height", "sigma_heigth", "table.sigma_heigth: unknown key; the nearest valid one is 'sigma_height'"),
    ("position: 0.1,", "postion: 0.1,", "camera.noise.postion: unknown key; the nearest valid one is 'position'"),
    ("table:", "tabel:", "tabel: unknown key; the nearest valid one is 'table'"),
    ("truth: ", "thruth: ", "topics.thruth: unknown key; the nearest valid one is 'truth'"),
    ('world: "map"', 'earth: "map"', "frames.earth: unknown key; valid: camera, palm, world"),
    ("version: 1", "version: 2", "version: expected 1, got 2"),
    ("version: 1", "version: one", "version: expected a finite number, got one (a text)"),
    ("fingers:\n", "figners:\n", "figners: unknown key; the nearest valid one is 'fingers'"),
    ("fingers:\n", "fingers: 5\nfigners:\n", "fingers: expected keys and values, got 5"),
    ("fingers:\n", "fingers: [a]\nfigners:\n", "fingers: expected keys and values, got ['a']"),
    ('palm: "palm"', 'palm: "plam"', "hand.palm: expected a body of pinch.urdf, got 'plam'; the nearest valid one is 'palm'"),
    ('palm: "palm"', "palm: [palm]", "hand.palm: expected a text, got ['palm']"),
    ('palm: "palm"', "palm: ' '", "hand.palm: expected a text, got  "),
    ("thumb_tip", "thumbtip", "fingers.thumb.frame: expected a body of pinch.urdf, got 'thumbtip'; the nearest valid one is 'thumb_tip'"),
    ("joint_offset_deg: ", "joint_offset_deg: '1' #", "hand.joint_offset_deg: expected a finite number, got 1 (a text)"),
    ("joint_offset_deg: ", "joint_offset_deg: -1 #", "hand.joint_offset_deg: expected a number of at least 0, got -1"),
    ("joint_offset_deg: ", "joint_offset_deg: .nan #", "hand.joint_offset_deg: expected a finite number, got nan"),
    ("joint_offset_deg: ", f"joint_offset_deg: 0x{'f' * 5000} #", "hand.joint_offset_deg: expected a finite number, got a whole number of thousands of digits"),
    ("  height: ", "  height: true #", "table.height: expected a finite number, got True"),
    ("  height: ", "  height: 0 mm #", "table.height: expected a finite number, got 0 mm (a text)"),
    ("sigma_height: ", "sigma_height: 0 #", "table.sigma_height: expected a number above 0, got 0"),
    ("tip_mass: ", "tip_mass: 4 #", "fingers.index.sensor.tip_mass: expected kilograms, got 4 (grams?)"),
    ("surface: {position: [", "surface: {position: [16.5e+3, 0, 0]} #", "fingers.index.surface.position: expected metres within 0.5, got [16500, 0, 0] (millimetres?)"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [9, 9, 14.5]", "fingers.index.tip.ellipsoid: semi_axes[0]: expected metres, at most 0.2, got 9 (millimetres? 0.009 m)"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [0.009, true, 0.02]", "fingers.index.tip.ellipsoid[1]: expected a finite number, got True"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "ellipsoid: [0.009, '0.01', 0.02]", "fingers.index.tip.ellipsoid[1]: expected a finite number, got 0.01 (a text)"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "elipsoid: [0.009, 0.01, 0.02]", "fingers.index.tip.elipsoid: unknown key; the nearest valid one is 'ellipsoid'"),
    ("ellipsoid: [0.009, 0.01, 0.02]", "sphere: 1, ellipsoid: [1, 1, 1]", "fingers.index.tip: expected ellipsoid: [a, b, c] or sphere: r, got ellipsoid and sphere"),
    ("surface: {position: [", "surface: {position: [0, 0, 16.5]} #", "fingers.index.surface.position: expected metres within 0.5, got [0, 0, 16.5] (millimetres? [0, 0, 0.0165] m)"),
    ("tip_center: ", "tip_center: [0, 0, 14.5] #", "fingers.index.sensor.tip_center: expected metres within 0.5, got [0, 0, 14.5] (millimetres? [0, 0, 0.0145] m)"),
    ("sigma_point: ", "sigma_point: 5 #", "fingers.index.sigma_point: expected metres within 0.2, got 5 (millimetres? 0.005 m)"),
    ("sigma_normal_deg: ", "sigma_normal_deg: 200 #", "fingers.index.sigma_normal_deg: expected a number of at most 180, got 200"),
    ("{position: 0.1,", "{position: 64,", "camera.noise.position: expected metres within 5, got 64 (millimetres? 0.064 m)"),
    ("  height: ", "  height: 750 #", "table.height: expected metres within 100, got 750 (millimetres? 0.75 m)"),
    ("{radius: 0.1,", "{radius: 33,", "objects.tin.cylinder.radius: expected metres within 5, got 33 (millimetres? 0.033 m)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [60, 90, 140]}", "objects.a box.box: expected metres within 5, got [60, 90, 140] (millimetres? [0.06, 0.09, 0.14] m)"),
    ("bias: {force: [", "bias: {force: [1.0e+9, 0, 0]} #", "fingers.index.sensor.bias.force: expected newtons and newton metres within 100000, got 1e+09"),
    ("thumb_tip", "index_tip", "fingers.thumb.frame: expected a body of its own, got 'index_tip', which is fingers.index.frame's"),
    ('"thumb": "/b: c"', '"thumb": "/a"', "topics.wrenches.thumb: expected a topic of its own, got '/a', which is topics.wrenches.index's"),
    ('truth: "/t"', 'truth: "/see"', "topics.truth: expected a topic of its own, got '/see', which is topics.vision's"),
    ("full_scale: [30, 0.7]", "full_scale: [30, 0]", "fingers.index.sensor.full_scale[1]: expected a number above 0, got 0"),
    ("reading: on_sensor", "reading: on_senser", "fingers.index.sensor.reading: expected one of on_sensor, on_tip, got 'on_senser'; the nearest valid one is 'on_sensor'"),
    ("fixed_to: palm", "fixed_to: wrist", "camera.fixed_to: expected one of world, palm, got 'wrist'; valid: palm, world"),
    ("depth_camera: stereo", "depth_camera: steroe", "camera.depth_camera: expected one of structured_light, time_of_flight, stereo, got 'steroe'; the nearest valid one is 'stereo'"),
    ("  lens: [", "  lens: [0.1, 0.2] # [", "camera.lens: expected 0, 4, 5, 8 numbers, got 2"),
    ("  lens: [", "  lens: [a, 0, 0, 0] # [", "camera.lens[0]: expected a finite number, got a (a text)"),
    ("  lens: [", "  lens: 0.1 # [", "camera.lens: expected a list, got 0.1"),
    ("  lens: [", "  lense: [", "camera.lense: unknown key; the nearest valid one is 'lens'"),
    ("  intrinsics: {", "  #", "camera.lens: expected intrinsics beside it, got none"),
    ("palm_from: joints", "palm_from: sky", "world.palm_from: expected one of tf, joints, nowhere, got 'sky'"),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: [0, 0, -981]", "world.gravity: expected a vector of 1.5 to 30 m/s², got length 981"),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: [0, 0]", "world.gravity: expected 3 finite numbers, got [0, 0]"),
    ('"index": "/a"', '"indx": "/a"', "topics.wrenches.indx: unknown finger; the nearest valid one is 'index'"),
    ("{box: [0.1,", "{box: [-0.1,", "objects.a box.box[0]: expected a number above 0, got -0.1"),
    ("{box: [0.1, 0.7, 0.004]}", "{boks: [1, 1, 1]}", "objects.a box.boks: unknown key; the nearest valid one is 'box'"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mesh: a.stl}", "objects.a box: expected one of box, cylinder, mesh, name, got box and mesh"),
    ("{radius: 0.1,", "{radios: 0.1,", "objects.tin.cylinder.radios: unknown key; the nearest valid one is 'radius'"),
    ("{radius: 0.1,", "{", "objects.tin.cylinder.radius: expected a finite number, got nothing"),
    ("{box: [0.1, 0.7, 0.004]}", "{}", "objects.a box: expected one of box, cylinder, mesh, name, got none"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mass: 150}", "objects.a box.mass: expected kilograms, got 150 (grams?)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], mass: 0}", "objects.a box.mass: expected a number above 0, got 0"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0, 30]}", "objects.a box.center_of_mass: expected metres within 5, got [0, 0, 30] (millimetres? [0, 0, 0.03] m)"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: homogenous}", "objects.a box.center_of_mass: expected 3 finite numbers or one of homogeneous, got 'homogenous'; the nearest valid one is 'homogeneous'"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0]}", "objects.a box.center_of_mass: expected 3 finite numbers, got [0, 0]"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], center_of_mass: [0, 0, .nan]}", "objects.a box.center_of_mass"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], sigma_center_of_mass: 0.001}", "objects.a box.sigma_center_of_mass: expected beside center_of_mass only, got it alone"),
    ("{box: [0.1, 0.7, 0.004]}", "{box: [1, 1, 1], scale: 2}", "objects.a box.scale: expected beside mesh only, got it beside box"),
    ("ellipsoid: [0.009, 0.01, 0.02], ", "", "fingers.index.tip: expected ellipsoid: [a, b, c] or sphere: r, got neither"),
    ("surface: {position: [", "surface: {quaternion_xyzw: [0, 0, 0, 0]} #", "fingers.index.surface.quaternion_xyzw: expected a direction, got a zero vector"),
    ('"index": "/a"', '"index": [1]', "topics.wrenches.index: expected a text, got [1]"),
    ("gravity: [0.1, 9.7, 0.004]", "gravity: 9.81", "world.gravity: expected 3 finite numbers, got 9.81"),
    ("scale: 0.004}", "scale: 0}", "objects.mug.scale: expected a number above 0, got 0"),
    ("pinch.urdf", "none.urdf", "hand.file: {folder}/none.urdf: expected a file, got none of that name"),
    ("pinch.urdf", "a" * 300, "hand.file: {folder}/aaa"),
    ("version: 1", "version: 1\nversion: 1", 'expected YAML, got: found duplicate key "version"'),
    ("version: 1", "1: 2\nversion: 1", "file: expected names as keys, got 1 (not quoted?)"),
    ("hand:", "hand: !!python/object:os.system", "hand: expected values without tags, got tag:yaml.org,2002:python/object:os.system"),
    ("joint_offset_deg: ", "joint_offset_deg: !!python/name:os.system 3 #", "hand.joint_offset_deg: expected values without tags, got tag:yaml.org,2002:python/name:os.system"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "expected"), MISTAKES, ids=[expected[:50] for *_, expected in MISTAKES]
)
def test_a_mistake_is_reported_at_its_line(folder, text, old, new, expected):
    assert old in text
    line, message = refused(folder, text.replace(old, new, 1))
    assert message.startswith(expected.replace("{folder}", str(folder)))
    at = text[: text.index(old)].count("\n") + 1
    # A key and what is missing are told at the mapping they are in.
    assert at - 2 <= line <= at + 1


@pytest.mark.parametrize("section", ["version", "hand", "fingers"])
def test_what_cannot_be_left_out_is_named_where_its_name_is_misspelt_and_where_it_is_not_there(
    folder, text, section
):
    line, message = refused(folder, text.replace(f"\n{section}:", f"\nx{section}:", 1))
    assert line == text[: text.index(f"\n{section}:")].count("\n") + 2
    assert message == f"x{section}: unknown key; the nearest valid one is {section!r}"
    needed = {
        "version": "version: 1",
        "hand": "hand: {file: pinch.urdf, palm: palm}",
        "fingers": "fingers: {}",
    }
    message = refused(folder, "\n".join(value for name, value in needed.items() if name != section))[1]
    assert (
        message
        == f"{section}: expected {'a finite number' if section == 'version' else 'keys and values'}, got nothing"
    )


def test_two_tips_at_one_place_are_refused_and_so_is_one_finger_twice_in_python(folder):
    urdf = URDF.replace("</robot>", '<link name="pad"/>{}</robot>').format(
        '<joint name="glue" type="fixed"><parent link="index_tip"/><child link="pad"/></joint>'
    )
    (folder / "glued.urdf").write_text(urdf)
    finger = "{{frame: {}, tip: {{sphere: 0.01}}, sensor: {{reading: on_tip}}}}"
    text = "version: 1\nhand: {file: glued.urdf, palm: palm}\nfingers:\n"
    text += f"  a: {finger.format('index_tip')}\n  b: {finger.format('pad')}\n"
    assert refused(folder, text) == (
        5,
        "fingers.b.surface: expected a place of its own, got that of fingers.a",
    )
    rig = full(folder)
    index = rig.fingers["index"]
    with pytest.raises(
        InvalidInput, match=r"^fingers\['thumb'\]\.frame: expected the body of the hand's tip"
    ):
        replace(rig, fingers={"index": index, "thumb": index})
    with pytest.raises(InvalidInput, match=r"^topics\.truth: expected a topic of its own, got '/see'"):
        replace(rig, topics=replace(rig.topics, truth="/see"))
    with pytest.raises(InvalidInput, match=r"^sigma_point: expected a number from 0 to 1000, got -1"):
        replace(index, sigma_point=-1.0)


def test_a_rig_without_fingers_is_reported(folder):
    text = "version: 1\nhand: {file: pinch.urdf, palm: palm}\nfingers: {}\n"
    assert refused(folder, text) == (3, "fingers: expected at least one finger, got none")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "expected a mapping of keys to values, got None"),
        ("- a\n", "expected a mapping of keys to values, got ['a']"),
        ("hello", "expected a mapping of keys to values, got hello"),
        (b"\xff\xfe\x00", "expected YAML in UTF-8, got other bytes"),
        (b"version: 1 # \xe9", "expected YAML in UTF-8, got other bytes"),
        (
            "#" * (MAX_BYTES + 1),
            f"expected at most {MAX_BYTES} bytes, got {MAX_BYTES + 1}",
        ),
        ("version: [1", "expected YAML, got: expected ',' or ']', but got '<stream end>'"),
        ("version: 1\n---\nversion: 1", "expected YAML, got: but found another document"),
        ("[" * 1000, "expected YAML, got: maximum recursion depth exceeded"),
        (
            "- " * 400 + "1",
            "expected a mapping of keys to values, got ",
        ),  # how deep Python says, its versions differ
        ("a: [" + "1," * MAX_VALUES, TOO_MANY),
        ("a: 1\n" * (MAX_VALUES + 1), TOO_MANY),
        ("a: &a\n  <<: *a\n  b: 1\n", "expected YAML, got tags, merges or aliases that stand for nothing"),
        ("a: " + "9" * 5000, "expected YAML, got: Exceeds the limit"),
        ("version: 1\n" + "x" * 900 + ": 1\n", "x" * MAX_NAME_LENGTH + ": unknown key"),
        ("version: \0", "expected YAML, got: "),
        ("? [a]\n: 1\n", "file: expected names as keys, got "),
        ("version: *a", "expected YAML, got: found undefined alias 'a'"),
    ],
)
def test_what_is_no_rig_is_reported(folder, content, expected):
    _, message = refused(folder, content)
    assert message.startswith(expected)


def test_a_few_lines_that_stand_for_billions_are_refused_at_once(folder):
    lines = ["a: &a [1, 2]"]
    for last, name in zip("abcdefghijkl", "bcdefghijklm", strict=True):
        lines.append(f"{name}: &{name} [{', '.join([f'*{last}'] * 10)}]")
    _, message = refused(folder, "\n".join(lines))
    assert message == TOO_MANY


def test_no_file_is_reported(folder):
    with pytest.raises(InvalidFile, match=r"none\.yaml: cannot be read: No such file or directory$"):
        Rig.from_file(folder / "none.yaml")
    with pytest.raises(InvalidFile, match="expected a file, got a folder$"):
        Rig.from_file(folder)
    if Path("/dev/zero").exists():
        with pytest.raises(InvalidFile, match="^/dev/zero: expected a file, got something else$"):
            Rig.from_file("/dev/zero")
    with pytest.raises(InvalidInput, match="^path: expected a path, got 5$"):
        Rig.from_file(5)


TOKENS = ["!!python/object:os.x ", "&a ", "*a", "<<: *a", "null", "true", "1e400", "-1", "[[1]]", "{a: 1}", "~", "!!set ",
          "!!omap ", "!!binary ", "!!timestamp ", "2001-01-01", "---\n", "%YAML 1.1\n", "? ", '"\\ud800"', '"\\0"', "\x00",
          "\x85", "\ufeff", "é", "'", '"', "\t", "\n", "#", "|", ">", "@", "`"]  # fmt: skip


def mutated(text, rng):
    """The text with up to four things put in, left out or moved."""
    for _ in range(rng.randint(1, 4)):
        lines, at = text.splitlines(keepends=True), rng.randrange(len(text))
        kind = rng.random()
        if kind < 0.6:
            value = text.find(": ", at) + 2 if kind < 0.4 else at
            text = text[:value] + rng.choice(TOKENS) + text[value + rng.choice([0, 1, 5]) :]
        elif kind < 0.75:
            text = text[:at] + text[at + rng.randint(1, 30) :]
        elif kind < 0.9:
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = "".join(lines)
        else:
            del lines[rng.randrange(len(lines))]
            text = "".join(lines)
    return text


def test_no_text_brings_the_reader_down(folder, text):
    path, rng, was_read = folder / "spoilt.yaml", random.Random(0), 0
    for _ in range(150):
        path.write_bytes(mutated(text, rng).encode("utf-8", "surrogatepass"))
        try:
            Rig.from_file(path)
        except HandsightError:
            continue
        was_read += 1
    assert 0 < was_read < 75
