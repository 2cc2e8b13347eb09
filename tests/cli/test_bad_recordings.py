"""Bad recordings: each gives a sentence, and what could be tracked is written."""

import dataclasses
import itertools
import re

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
