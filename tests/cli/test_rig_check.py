"""`handsight rig check`, as a user runs it: which sensor's readings cannot be used, and what to change."""

import re

import numpy as np
import pytest

from cli.commands import called
from handsight.observation import Observation, PoseMeasurement
from handsight.recording import RecordingWriter
from handsight.rig import Rig
from handsight.rig.schema import schema

HAND = """<robot name="two">
<link name="palm"><visual><geometry><box size="0.08 0.08 0.02"/></geometry></visual></link>
{fingers}</robot>"""
FINGER = """<link name="{name}"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
<joint name="{name}_joint" type="revolute"><parent link="palm"/><child link="{name}"/>
<origin xyz="{x} 0 0.05"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
"""
RIG = """version: 1
hand: {{file: hand.urdf, palm: palm}}
fingers:
  index: {{frame: index, tip: {{sphere: 0.01}}, sensor: {{reading: on_sensor}}}}
  thumb: {{frame: thumb, tip: {{sphere: 0.01}}}}
skin:
  pad: {{{pad}, {more}}}
world: {{palm_from: nowhere}}
"""
GRID = "frame: thumb, pose: {position: [0, 0, 0.01]}, rows: 4, columns: 5, pitch: 0.004"


@pytest.fixture
def check(tmp_path, monkeypatch, capsys):
    """The exit code and the lines of `rig check` with a recording of that pad's readings and wrenches (n, 6)."""
    fingers = "".join(FINGER.format(name=name, x=x) for name, x in (("index", -0.02), ("thumb", 0.02)))
    (tmp_path / "hand.urdf").write_text(HAND.format(fingers=fingers))

    def run(readings, more="threshold: 0.1", wrenches=None, pad=GRID, record_as=None):
        write = (tmp_path / "hand.rig.yaml").write_text
        write(RIG.format(pad=pad, more=record_as or more))
        rig = Rig.from_file(tmp_path / "hand.rig.yaml")
        with RecordingWriter(tmp_path / "a.mcap", rig) as writer:
            for k, each in enumerate(readings):
                wrench = np.append(0.01 * np.sin(np.arange(k, k + 3)), np.zeros(3))
                wrenches_now = {"index": wrench if wrenches is None else wrenches[k]}
                joints = {"index_joint": 0.001 * k, "thumb_joint": 0.0}
                vision = PoseMeasurement(np.eye(4), "palm")
                writer.write(Observation(100 + 0.02 * k, joints, wrenches_now, vision, skin={"pad": each}))
        write(RIG.format(pad=pad, more=more))
        code = called(monkeypatch, tmp_path, "rig", "check", "hand.rig.yaml", "a.mcap", columns=200)
        lines = capsys.readouterr().out.splitlines()
        # What is wrong begins with a dash, and with nothing wrong no line does.
        assert any(line.startswith("- ") for line in lines) == (code == 1)
        assert ("a.mcap has everything that this rig listens to." in lines) == (code == 0)
        return code, lines

    return run


def pressed(count=60, components=1):
    """Readings [N] with noise, of which the second half are of a press of 2 N on the middle: (count, 4, 5[, 3])."""
    rng = np.random.default_rng(0)
    readings = 0.01 * rng.normal(size=(count, 4, 5, components))
    readings[count // 2 :, 1:3, 1:4, -1] += (
        2 * np.sin(np.linspace(0.2, 1.5, count - count // 2))[:, None, None]
    )
    return readings[..., 0] if components == 1 else readings


def faults(lines):
    return [line for line in lines if line.startswith(("- skin", "- finger", "note: skin", "note: finger"))]


def test_a_pad_that_reads_newtons_is_without_fault_and_its_finger_is_touched(check):
    code, lines = check(pressed())
    assert code == 0, lines
    assert "a.mcap has everything that this rig listens to." in lines
    assert [line[:17] for line in faults(lines)] == [
        "note: finger inde"
    ]  # whose wrench is of nothing but noise


@pytest.mark.parametrize(("value", "text"), [(0.0, "zero"), (7.0, "the same")])
def test_a_pad_that_never_changes_is_named_with_its_topic(check, value, text):
    code, lines = check(np.full((60, 4, 5), value))
    assert code == 1, lines
    said = f"- skin pad: /pad/taxels: all 60 readings are {text}: is the sensor on, and is this the field that its"
    assert [line for line in lines if line.startswith(said)]


def test_a_hand_whose_driver_was_started_without_its_sensors_flag_is_told_of_the_flag(check):
    code, lines = check(pressed(), wrenches=np.zeros((60, 6)))
    assert code == 1, lines
    said = "- finger index: /index/wrench: all 60 readings are zero: is the sensor on, and does its driver read it (DG-5F"
    assert [line for line in lines if line.startswith(said)]
    code, lines = check(pressed(), wrenches=np.full((60, 6), 0.5))
    assert "- finger index: /index/wrench: all 60 readings are the same: is the sensor on, and" in "\n".join(
        lines
    )


def test_the_change_that_is_proposed_for_an_inverted_sensor_mends_it(check):
    """2135 at rest, less where it is pressed, as Wuji's arrays are."""
    inverted = 2135 - np.round(900 * np.maximum(pressed(), 0))
    code, lines = check(inverted, "threshold: 30")
    assert code == 1, lines
    [line] = [line for line in faults(lines) if "inverted" in line]
    found = re.search(
        r"reads \d+ at rest and (\d+) where .*set skin\.pad\.(offset: 21\d\d) and (scale: -1) in", line
    )
    assert int(found[1]) == inverted.min()
    code, lines = check(inverted, f"threshold: 30, {found[2]}, {found[3]}")
    assert code == 0, lines
    assert not any("inverted" in line for line in lines)


def test_swapped_bytes_are_told_from_large_counts(check):
    """0 to 4095 big-endian, read as little-endian int16; then true counts of 16 bits."""
    counts = np.round(1500 * np.maximum(pressed(), 0)).astype(">i2")
    swapped = counts.view("<i2").astype(float)
    code, lines = check(swapped, "threshold: 60")
    assert code == 1, lines
    [line] = [line for line in faults(lines) if "swap" in line]
    assert f"at most {counts.max()} with their two bytes swapped, " in line
    assert not any("swap" in line for line in check(counts.astype(float), "threshold: 60")[1])
    wide = np.round(15000 * np.maximum(pressed(), 0))
    assert not any("swap" in line for line in check(wide, "threshold: 600")[1])


def test_counts_without_a_scale_are_refused_until_there_is_one(check):
    counts = 5000 * pressed(components=3) + 20000
    code, lines = check(counts, "threshold: 0.1, components: 3")
    assert code == 1, lines
    [line] = [line for line in faults(lines) if "counts?" in line]
    assert "set skin.pad.scale: newtons a count" in line
    assert "300 N" in line
    code, lines = check(counts, "threshold: 0.1, components: 3, scale: 0.0002")
    assert code == 0, lines
    assert not any("counts?" in line for line in lines)


def test_a_pad_that_is_pressed_for_most_of_a_recording_is_touched(check):
    """Its rest is what it reads least, not what it reads mostly."""
    readings = 0.01 * np.random.default_rng(0).normal(size=(60, 4, 5))
    readings[6:, 1:3, 1:4] += 1.0
    code, lines = check(readings)
    assert code == 0, lines
    assert not any("never touched" in line for line in lines if "pad" in line)


def test_a_pad_that_nothing_touches_and_taxels_that_never_change_are_remarks(check):
    readings = 0.01 * np.random.default_rng(0).normal(size=(60, 4, 5))
    readings[:, 0, 3] = 0.02
    code, lines = check(readings)
    assert code == 1, lines  # as no finger touched anything
    assert any(
        line.startswith("note: skin pad: never touched; a touched taxel rises by 0.1, and the")
        for line in lines
    )
    assert "note: skin pad: taxel 3 of 20 never change: dead?" in lines
    readings = pressed()
    readings[:, 0, 3] = np.nan
    code, lines = check(readings)
    assert code == 0, lines


def test_a_taxel_without_a_number_is_left_out_and_the_others_count(check):
    readings = pressed()
    readings[:, 3, 4] = np.nan
    code, lines = check(readings)
    assert code == 0, lines
    assert [line for line in lines if "skin pad: taxel" in line] == [
        "note: skin pad: taxel 19 of 20 never have a number (NaN)"
    ]


@pytest.mark.parametrize(("z", "normal", "told"), [
    (0.01, 1, ""), (0.01, -1, "expected normals that point out of the mesh of 'thumb', got into it"),
    (0.03, 1, "expected taxels within 15 mm of the mesh of 'thumb', got taxel"),
])  # fmt: skip
def test_taxels_are_compared_with_their_links_mesh(check, monkeypatch, tmp_path, capsys, z, normal, told):
    check(pressed())  # which writes the hand's file
    places = [[0.003 * i, 0.003 * j, z, 0, 0, normal] for i in range(-1, 2) for j in range(-1, 2)]
    pad = f"frame: thumb, taxels: {places}"
    (tmp_path / "hand.rig.yaml").write_text(RIG.format(pad=pad, more="threshold: 0.1"))
    code = called(monkeypatch, tmp_path, "rig", "check", "hand.rig.yaml", columns=200)
    assert code == bool(told)
    assert (f"- skin pad: {told}" in capsys.readouterr().out) == bool(told)


def test_the_reference_of_the_rig_file_is_printed(monkeypatch, tmp_path, capsys):
    assert called(monkeypatch, tmp_path, "rig", "schema") == 0
    assert capsys.readouterr().out == schema()


def test_a_wrench_of_a_finger_without_a_sensor_is_refused(check, monkeypatch, tmp_path, capsys):
    check(pressed())
    text = RIG.format(pad=GRID, more="threshold: 0.1") + "topics: {wrenches: {thumb: /thumb/wrench}}\n"
    (tmp_path / "hand.rig.yaml").write_text(text)
    assert called(monkeypatch, tmp_path, "rig", "check", "hand.rig.yaml", columns=200) != 0
    assert "topics.wrenches.thumb: expected a sensor in fingers.thumb, got none" in capsys.readouterr().err


def test_a_tip_that_points_into_its_finger_is_told_without_a_recording(check, monkeypatch, tmp_path, capsys):
    check(pressed())
    hand = (tmp_path / "hand.urdf").read_text().replace('sphere radius="0.01"', 'box size="0.02 0.02 0.04"')
    (tmp_path / "hand.urdf").write_text(hand)
    text = RIG.replace("sensor: {{", "surface: {{position: [0, 0, {z}]}}, sensor: {{")
    for z, code in ((0.02, 0), (-0.02, 1)):
        (tmp_path / "hand.rig.yaml").write_text(text.format(pad=GRID, more="threshold: 0.1", z=z))
        assert called(monkeypatch, tmp_path, "rig", "check", "hand.rig.yaml", columns=200) == code
        told = "- fingers.index.surface: the tip points into its finger" in capsys.readouterr().out
        assert told == bool(code)
