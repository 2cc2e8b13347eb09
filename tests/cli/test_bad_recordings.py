"""Bad recordings: each gives a sentence, and what could be tracked is written."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from cli.tracks import assert_tracked, observations, recorded, track
from handsight.errors import InvalidFile
from handsight.recording.write import McapFile
from testbed.refusals import refused


def test_a_good_recording_has_nothing_to_say(grasp, tmp_path):
    rig, samples = grasp
    path = recorded(
        tmp_path / "a.mcap",
        observations(grasp),
        rig,
        [(s.observation.stamp, s.T_palm_object) for s in samples],
    )
    ended, _ = track(path, rig, tmp_path / "out")
    assert ended.messages == []
    assert ended.errors["tracked"].base[-1] < 0.004 < 0.03 < ended.errors["vision"].base[-1]
    assert len(ended.steps) == len(samples)


def test_without_joint_states_nothing_can_be_tracked_and_that_is_said(grasp, tmp_path):
    rig, _ = grasp
    path = recorded(
        tmp_path / "a.mcap", (dataclasses.replace(s, joint_positions=None) for s in observations(grasp)), rig
    )
    with refused(InvalidFile, "a.mcap"):
        track(path, rig)


def test_an_unknown_finger_is_named(grasp, tmp_path):
    rig, _ = grasp
    names = {**rig.topics.wrenches, "th": "/thumb/wrench"}
    strange = dataclasses.replace(rig, topics=dataclasses.replace(rig.topics, wrenches=names))
    path = recorded(tmp_path / "a.mcap", observations(grasp), strange)
    ended = assert_tracked(
        path, rig, tmp_path / "out", r"^finger th: no wrench on /th/wrench; the nearest is '/thumb/wrench'$"
    )
    assert "/thumb/wrench: wrenches of no finger of the rig; not used" in ended.messages
    assert {finger for step in ended.steps for finger in step.fingers} == {"ff", "mf", "rf", "lf"}


def test_depth_in_a_wrong_unit_is_reported(grasp, tmp_path):
    rig, _ = grasp
    topics = dataclasses.replace(rig.topics, depth="/camera/depth")
    rig = dataclasses.replace(rig, topics=topics)
    depth = np.full((6, 8), 0.009, dtype=np.float32)  # is written as 9 mm, as 9 m would be in metres
    seen = (dataclasses.replace(s, depth=depth) for s in observations(grasp))
    path = recorded(tmp_path / "a.mcap", seen, rig)
    said = r"^/camera/depth: 39 of 39 messages left out: expected depth in millimetres \(16UC1\), got a median of 9 \(another unit\?.*\)$"
    ended = assert_tracked(path, rig, tmp_path / "out", said)
    assert ended.tally.answered == 39


def test_a_file_that_is_cut_in_a_chunk_is_tracked_up_to_the_cut(grasp, tmp_path):
    rig, _ = grasp
    seen = observations(grasp)
    more = [dataclasses.replace(seen[-1], stamp=seen[-1].stamp + (k + 1) / 20) for k in range(800)]
    path = recorded(tmp_path / "a.mcap", [*seen, *more], rig)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    ended = assert_tracked(path, rig, tmp_path / "out", r"a\.mcap: damaged, and read only up to there")
    assert len(ended.steps) < 839


def test_an_empty_file_is_refused_in_a_sentence(grasp, tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"")
    with refused(InvalidFile, "a.mcap"):
        track(tmp_path / "a.mcap", grasp[0])


def test_stamps_that_go_back_are_reported_and_begin_a_new_track(grasp, tmp_path, monkeypatch):
    rig, _ = grasp
    seen = observations(grasp)
    shift = 10 - seen[0].stamp
    looped = [dataclasses.replace(s, stamp=s.stamp + shift) for s in seen]
    logged, original = itertools.count(1), McapFile.append

    def append_in_turn(self, topic, kind, stamp, **fields):
        original(self, topic, kind, next(logged) / 200, **fields)

    with monkeypatch.context() as patch:  # when it was recorded goes on
        patch.setattr(McapFile, "append", append_in_turn)
        again = [dataclasses.replace(s, stamp=s.stamp - 5) for s in looped]
        path = recorded(tmp_path / "a.mcap", [*looped, *again], rig)
    ended, _ = track(path, rig)  # a table of it has each stamp twice
    told = r"/joint_states: stamps went back 1 time, by up to [\d.]+ s, first from [\d.]+ s \(.*: a new track each time"
    assert re.match(told, ended.messages[0])
    begun = [b for a, b in itertools.pairwise(ended.steps) if b.stamp < a.stamp]
    assert len(begun) == 1
    assert begun[0].reason.startswith("the clock went back by ")
    assert ended.steps[-1].stamp == pytest.approx(again[-1].stamp)


def test_a_wrench_that_is_stuck_at_full_scale_is_a_dead_sensor(grasp, tmp_path):
    rig, _ = grasp
    dead = np.array([0, 0, -50.0, 0, 0, 0])
    path = recorded(
        tmp_path / "a.mcap",
        (dataclasses.replace(s, wrenches={**s.wrenches, "th": dead}) for s in observations(grasp)),
        rig,
    )
    ended = assert_tracked(
        path,
        rig,
        tmp_path / "out",
        r"^/th/wrench: 39 of 39 messages left out: at full scale \(50 N, 0\.5 N m\): a dead sensor, or another unit\?$",
    )
    assert "th" not in {finger for step in ended.steps for finger in step.fingers}


def test_a_joint_that_is_not_a_number_is_named(grasp, tmp_path):
    rig, _ = grasp
    seen = observations(grasp)
    joint = rig.hand.moving[0]
    for k in range(20, 25):
        seen[k] = dataclasses.replace(
            seen[k], joint_positions={**seen[k].joint_positions, joint: float("nan")}
        )
    path = recorded(tmp_path / "a.mcap", seen, rig)
    ended = assert_tracked(
        path,
        rig,
        tmp_path / "out",
        rf"^/joint_states: 5 of 39 messages left out: expected a position of joint {joint} within 1e\+06, got nan$",
    )
    assert len(ended.steps) == 34


def test_a_hand_whose_joint_is_not_in_the_recording_says_so(grasp, tmp_path):
    rig, _ = grasp
    joint = "robot0:THJ0"
    less = (
        {name: value for name, value in s.joint_positions.items() if name != joint}
        for s in observations(grasp)
    )
    seen = [
        dataclasses.replace(s, joint_positions=joints)
        for s, joints in zip(observations(grasp), less, strict=True)
    ]
    ended, written = track(recorded(tmp_path / "a.mcap", seen, rig), rig, tmp_path / "out")
    assert any(
        said.startswith(f"joint {joint!r}: never on /joint_states; the nearest is 'robot0:THJ")
        for said in ended.messages
    )
    assert any(
        sentence.startswith(
            f"39 observations left out: joint_positions: expected a position for {joint}; got "
        )
        for sentence in ended.sentences()
    )
    assert written[0].startswith("wrote ")
    assert not written[1:]
    assert (tmp_path / "out" / "track.tum").read_text() == ""
