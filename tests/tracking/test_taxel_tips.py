"""Taxels on fingertips: their patches are the fingers' contacts; faulty taxels are left out, and named."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.contact import TactileSurface
from handsight.errors import InvalidInput
from handsight.recording import RecordingWriter, open_recording
from handsight.tracking import FingertipSensors, SkinContacts, SkinSensors, TrackerSettings
from testbed import skin_scenes
from testbed.refusals import refused


@pytest.fixture(scope="module")
def taxels(can):
    """The can's rig with 30 three-axis taxels on each tip, and its observations with taxels in place of wrenches."""
    rig, shapes = skin_scenes.with_taxels(can.rig, np.random.default_rng(0))
    return rig, shapes, list(skin_scenes.taxel_observations(rig, shapes, can.observations, 3))


def followed(rig, model, observations):
    tracker = hs.Tracker(rig, model, settings=TrackerSettings(uncertain_position=0.015))
    for observation in observations:
        tracker.update(observation)
    return tracker


def test_a_hand_of_taxels_alone_is_tracked_as_one_of_wrenches(can, taxels):
    """Across the can's axis, along which its side says nothing."""
    rig, _, observations = taxels
    errors = []
    for each, given in ((can.rig, can.observations), (rig, observations)):
        tracker = followed(each, can.model, given)
        assert tracker.state == "tracking", (tracker.reason, tracker.sigma, len(errors))
        shift = se3.difference(tracker.estimate.T_palm_object, can.T_palm_object)[:3]
        axis = can.T_palm_object[:3, 2]
        errors.append(np.linalg.norm(shift - shift @ axis * axis))
    assert len(tracker.fingertips.fingers) >= 3
    assert errors[1] < errors[0] + 2e-3
    assert not tracker.skin.faults


def test_a_patch_on_a_tip_has_the_joints_errors_and_the_load(can, taxels):
    rig, _, observations = taxels
    observation, skin, sensors = observations[-1], SkinContacts(), SkinSensors(rig)
    skin = sensors.observed(observation, skin, touched=True)
    touch = FingertipSensors(rig).contacts(observation, None, skin)
    wrenches = FingertipSensors(can.rig).contacts(can.observations[-1])
    common = [name for name in touch.fingers if name in wrenches.fingers]
    assert len(common) >= 3
    for name in common:
        i, k = touch.fingers.index(name), wrenches.fingers.index(name)
        surface, (found, pose) = rig.skin[name], skin.touches[name]
        expected = found.contacts(pose.placed[0]).points_palm
        assert np.abs(expected - touch.contacts.points_palm[i]).sum(axis=1).min() < 1e-9
        own = found.patches[found.strongest]["covariance"]
        J = touch.by_error[i, :3]
        finger = rig.fingers[name].sigma_point ** 2
        R = pose.placed[0][:3, :3]
        expected = R @ own[:3, :3] @ R.T + J @ J.T + finger * np.eye(3)
        more = touch.contacts.covariance[i, :3, :3] - expected  # where another tip may be touched, too
        np.testing.assert_allclose(more, more[0, 0] * np.eye(3), atol=1e-12)
        assert more[0, 0] >= -1e-12
        assert touch.loads[i, 3] == pytest.approx(wrenches.loads[k, 3], rel=0.3)
        assert surface.components == 3


def test_taxels_say_where_and_the_wrench_says_how_much(can, taxels):
    rig, shapes, _ = taxels
    both = next(skin_scenes.taxel_observations(rig, shapes, can.observations[-1:], 3, wrenches=True))
    skin = SkinSensors(rig).observed(both, touched=True)
    touch = FingertipSensors(rig).contacts(both, None, skin)
    alone = FingertipSensors(can.rig).contacts(can.observations[-1])
    assert touch.fingers == alone.fingers
    assert not touch.doubts
    np.testing.assert_array_equal(touch.loads[:, 3], alone.loads[:, 3])
    for name in skin.tips:
        i = touch.fingers.index(name)
        assert np.linalg.norm(touch.contacts.points_palm[i] - alone.contacts.points_palm[i]) > 0

    # The taxels of one tip read as if it were touched on its other side.
    name = next(iter(skin.tips))
    surface = rig.skin[name]
    distance = np.linalg.norm(surface.points - surface.points[surface.points[:, 0].argmax()], axis=1)
    other = np.zeros(surface.shape)
    other[:, 2] = np.maximum(1 - (distance / 0.007) ** 2, 0)
    wrong = replace(both, skin=dict(both.skin) | {name: other})
    skin = SkinSensors(rig).observed(wrong, touched=True)
    doubted = FingertipSensors(rig).contacts(wrong, None, skin)
    assert list(doubted.doubts) == [name]
    assert "its taxels and its wrench are" in doubted.doubts[name]
    i = doubted.fingers.index(name)
    apart = np.linalg.norm(doubted.contacts.points_palm[i] - alone.contacts.points_palm[i])
    assert np.trace(doubted.contacts.covariance[i, :3, :3]) > apart**2


def test_a_second_patch_on_a_tip_is_evidence_beside_the_fingers_contact(can):
    rig, _ = skin_scenes.with_taxels(can.rig, np.random.default_rng(0))
    name = next(iter(rig.fingers))
    surface = rig.skin[name]
    reading = np.zeros(surface.shape)
    for i, force in ((surface.points[:, 0].argmin(), 2.0), (surface.points[:, 0].argmax(), 1.0)):
        distance = np.linalg.norm(surface.points - surface.points[i], axis=1)
        reading[:, 2] += force * np.maximum(1 - (distance / 0.006) ** 2, 0)
    observation = replace(can.observations[-1], skin={name: reading}, wrenches={})
    skin = SkinSensors(rig).observed(observation, touched=True)
    assert len(skin.touches[name][0].patches) == 2
    assert skin.bears
    finger = FingertipSensors(rig).contacts(observation, None, skin).contacts
    beside = skin.evidence().contacts
    assert len(finger) == len(beside) == 1
    assert np.linalg.norm(finger.points_palm - beside.points_palm) > 0.008
    assert len(skin.contacts()) == 2


def test_readings_of_any_shape_are_the_same_after_a_recording(can, taxels, tmp_path):
    rig, _, observations = taxels
    flat = TactileSurface.grid(
        frame=rig.hand.palm,
        T_frame_grid=np.eye(4),
        rows=2,
        columns=3,
        pitch=0.004,
        threshold=0.1,
        components=3,
    )
    topics = replace(rig.topics, wrenches={}, skin={name: f"/{name}" for name in (*rig.skin, "flat")})
    rig = replace(rig, skin=dict(rig.skin) | {"flat": flat}, topics=topics)
    more = np.arange(18.0).reshape(2, 3, 3)
    given = [
        replace(each, stamp=1000 + each.stamp, skin=dict(each.skin) | {"flat": more})
        for each in observations[-20:]
    ]
    with RecordingWriter(tmp_path / "taxels.mcap", rig) as writer:
        for each in given:
            writer.write(each)
    with open_recording(tmp_path / "taxels.mcap", rig) as recording:
        heard = list(recording.observations())
    assert len(heard) == len(given)
    for name in rig.skin:
        np.testing.assert_allclose(heard[-1].skin[name], given[-1].skin[name], atol=1e-6)


class Watch:
    """A surface of the palm whose readings are observed one after the other."""

    def __init__(self, can, **fields):
        surface = skin_scenes.tip(
            skin_scenes.SHAPES["ball"], np.random.default_rng(0), components=1, **fields
        )
        self.surface = replace(surface, frame=can.rig.hand.palm)
        self.sensors, self.skin = SkinSensors(replace(can.rig, skin={"a": self.surface})), SkinContacts()
        self.rng, self.offset = np.random.default_rng(1), np.zeros(30)

    def read(self, more=0.0, *, touched=False, **fixed):
        """The touch after a reading of noise, the offset, and `more`; `fixed`: values by taxel, as t7=0.0."""
        reading = self.offset + 1e-3 * self.rng.normal(size=30) + more
        for taxel, value in fixed.items():
            reading[int(taxel[1:])] = value
        self.skin = self.sensors.observed(
            hs.Observation(0.0, skin={"a": reading}), self.skin, touched=touched
        )
        return self.skin.touches["a"][0]

    def press(self, taxel):
        """Forces of a press about a taxel."""
        distance = np.linalg.norm(self.surface.points - self.surface.points[taxel], axis=1)
        return np.maximum(1 - (distance / 0.008) ** 2, 0)


def test_dead_taxels_and_those_that_always_read_their_most_are_left_out_and_named(can):
    watch = Watch(can, full_scale=10.0)
    for _ in range(8):
        watch.read(t7=0.0, t12=10.0)
    assert watch.skin.faults == {"a": "dead: taxel 7; at full scale: taxel 12"}
    touch = watch.read(watch.press(7), touched=True, t7=0.0, t12=10.0)
    assert not touch.pressed[[7, 12]].any()
    assert not touch.untouched[[7, 12]].any()
    assert len(touch.patches) == 1


def test_taxels_in_a_dead_band_at_rest_are_not_dead(can):
    """Counts from 0 on: many of them read 0 at rest, whatever their noise, and are pressed later like the others."""
    watch = Watch(can)
    silent = {f"t{i}": 0.0 for i in range(0, 30, 2)}
    for _ in range(20):
        watch.read(**silent)
    assert not watch.skin.faults
    touch = watch.read(watch.press(4), touched=True)
    assert touch.pressed[4]


def test_offsets_before_the_first_baseline_are_no_contacts_of_tips(can, taxels):
    """Up to three thresholds; then they are known, and a press of the same size is a contact."""
    rig, _, observations = taxels
    rng, tracker = np.random.default_rng(4), hs.Tracker(rig, can.model)
    name = next(iter(rig.fingers))
    offsets = {key: rng.uniform(0, 3, each.shape) * each.threshold for key, each in rig.skin.items()}
    noise = {key: 1e-3 * rng.normal(size=(9, *each.shape)) for key, each in rig.skin.items()}
    for k in range(9):
        skin = {key: offsets[key] + noise[key][k] for key in offsets}
        if k == 8:
            surface = rig.skin[name]
            distance = np.linalg.norm(surface.points - surface.points[0], axis=1)
            skin[name][:, 2] += 3 * surface.threshold * np.maximum(1 - (distance / 0.008) ** 2, 0)
        stamp = observations[0].stamp + 0.01 * k
        tracker.update(replace(observations[0], stamp=stamp, skin=skin, wrenches={}))
        assert tracker.fingertips.fingers == ((name,) if k == 8 else ())
        assert set(tracker.fingertips.reasons.values()) == {"free"}  # not silent: their taxels read


def test_a_taxel_that_is_stuck_while_others_are_pressed_is_left_out_and_named(can):
    watch = Watch(can)
    for _ in range(8):
        watch.read()
    for _ in range(60):
        touch = watch.read(watch.press(3), touched=True, t3=0.7)
    assert watch.skin.faults == {"a": "stuck: taxel 3"}
    assert not touch.pressed[3]
    for _ in range(2):  # it moves again
        touch = watch.read(watch.press(3), touched=True)
    assert not watch.skin.faults
    assert touch.pressed[3]


def test_the_baseline_follows_a_drift_at_rest_and_one_that_drifts_far_is_left_out(can):
    watch = Watch(can)
    drift = np.zeros(30)
    drift[4], drift[5] = 2e-4, 1e-3
    for _ in range(400):
        watch.offset += drift
        touch = watch.read()
        assert not touch.pressed[4]
    assert watch.skin.faults["a"].startswith("drifting: taxel 4, 5")
    touch = watch.read(watch.press(5), touched=True)
    assert touch.pressed[4] == (watch.press(5)[4] > 0.5)
    assert not touch.pressed[5]


def test_a_touch_before_any_other_is_no_baseline_once_there_is_one(can):
    watch = Watch(can)
    for _ in range(10):
        watch.read()
    for _ in range(100):
        touch = watch.read(watch.press(2))  # no fingertip says that something is touched
    assert touch.pressed[2]
    assert np.abs(watch.skin.watched["a"].baseline).max() < 2e-3


def test_counts_without_a_scale_are_refused_with_the_surfaces_name(can, taxels):
    rig, _, observations = taxels
    name = next(iter(rig.fingers))
    counts = replace(observations[-1], skin={name: 1e4 * observations[-1].skin[name]})
    with refused(InvalidInput, f"observation.skin['{name}']"):
        hs.Tracker(rig, can.model).update(counts)


def test_taxels_that_are_pressed_from_the_first_reading_on_are_told(can, taxels):
    """Their offsets are unknown: a recording, or a node, begins with the hand closed."""
    rig, _, observations = taxels
    pressed = [each for each, held in zip(observations, can.observations, strict=True) if held in can.held]
    tracker = followed(rig, can.model, pressed)
    assert tracker.state == "uncertain"
    assert tracker.skin.unzeroed
    assert all(name in tracker.reason for name in tracker.skin.unzeroed)
    assert "offset" in tracker.reason
    opened = followed(rig, can.model, observations)
    assert not opened.skin.unzeroed
