"""A tracker propagates the pose, corrects it when there is new evidence, and reports when it is uncertain."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.evaluation import Truths, pose_errors, track_errors
from handsight.hand import Hand
from handsight.observation import PoseMeasurement
from handsight.tracking import Tracker, TrackerSettings
from handsight.tracking.replay import Tally, replay
from testbed.refusals import refused


def tracked(grasp, **settings):
    tracker = Tracker(grasp.rig, grasp.model, settings=TrackerSettings(**settings))
    for seen in grasp.observations:
        tracker.update(seen)
    return tracker


SHORT = 0.015
"""A grasp of two seconds knows a can that stands within 7 mm: its table may be misplaced."""


def later(observation, by, **changes):
    return replace(observation, stamp=observation.stamp + by, vision=None, **changes)


def base_error(grasp, T):
    given = (T, grasp.T_palm_object, grasp.observations[-1].T_world_palm)
    return pose_errors(grasp.model, *(np.array([each]) for each in given)).base[0]


def test_a_can_is_nearer_to_the_truth_by_touch_than_by_vision(can):
    tracker = tracked(can, uncertain_position=SHORT)
    with_vision = [o for o in can.observations if o.vision is not None]
    seen = [base_error(can, tracker.vision.in_palm(o, o.T_world_palm)) for o in with_vision]
    assert tracker.state == "tracking", tracker.reason
    assert base_error(can, tracker.estimate.T_palm_object) < min(0.004, np.mean(seen))


def test_a_box_gripped_by_two_faces_is_uncertain_along_them(box):
    """Its slide along the gripped faces is open; the rest is known."""
    tracker = tracked(box)
    values, vectors = np.linalg.eigh(tracker.estimate.covariance[:3, :3])
    across = tracker.estimate.T_palm_object[:3, 1]  # its 90 mm
    assert abs(vectors[:, 2] @ across) < 0.3
    assert np.sqrt(values[2]) > 2 * np.sqrt(across @ tracker.estimate.covariance[:3, :3] @ across)
    assert tracker.sigma > 0.004
    wary = tracked(box, uncertain_position=0.004)
    assert wary.state == "uncertain"
    assert "known to" in wary.reason
    off = se3.difference(tracker.estimate.T_palm_object, box.T_palm_object)
    assert off @ np.linalg.solve(tracker.estimate.covariance, off) < 22.5  # 99.9 % of six numbers


def test_points_of_the_hand_bound_a_slide_and_are_left_out_without_their_joints(box):
    tracker = tracked(box)
    inside = se3.apply(
        se3.inverse(tracker.estimate.T_palm_object),
        box.rig.hand.surface(200, without=[f.frame for f in box.rig.fingers.values()]).points_palm(
            box.held[-1].joint_positions
        ),
    )
    assert box.model.fine.evaluate(inside).distance.min() > -0.004
    # The ring finger holds nothing here: without one of its joints there is no surface, and all else goes on.
    three = {finger: box.rig.fingers[finger] for finger in ("ff", "mf", "th")}
    tips = {finger: f.frame for finger, f in three.items()}
    hand = Hand.from_file(box.rig.hand.file, palm=box.rig.hand.palm, tips=tips)
    rig = replace(box.rig, hand=hand, fingers=three)
    lacking = Tracker(rig, box.model)
    for seen in box.observations:
        joints = {name: q for name, q in seen.joint_positions.items() if name != "robot0:RFJ2"}
        wrenches = {name: seen.wrenches[name] for name in three}
        lacking.update(replace(seen, joint_positions=joints, wrenches=wrenches))
    assert lacking.corrections > 0


def test_there_is_no_pose_before_a_start_or_vision(can):
    tracker = Tracker(can.rig, can.model)
    assert tracker.state == "lost"
    assert tracker.update(replace(can.observations[0], vision=None)) is None
    assert (tracker.state, tracker.reason) == ("lost", "no pose yet: neither a start nor vision")


def test_a_start_given_by_the_user_needs_no_vision(can):
    off = se3.moved(can.T_palm_object, np.array([0.02, -0.01, 0.02, 0.1, 0.1, 0]))
    start = hs.PosePrior.from_sigmas(off, 0.03, 0.2)
    tracker = Tracker(can.rig, can.model, start=start)
    for seen in can.held:
        tracker.update(replace(seen, vision=None))
    assert tracker.state == "tracking", tracker.reason
    assert base_error(can, tracker.estimate.T_palm_object) < 0.004


def test_the_pose_stays_while_nothing_changes_and_its_covariance_grows_with_the_process_noise(box):
    tracker = tracked(box)
    last, corrections = box.observations[-1], tracker.corrections
    before = tracker.estimate
    for k in range(1, 20):
        after = tracker.update(later(last, 0.1 * k))
    assert tracker.corrections == corrections
    np.testing.assert_array_equal(after.T_palm_object, before.T_palm_object)
    growth = np.diagonal(after.covariance - before.covariance)
    np.testing.assert_allclose(growth[:3], 1.9 * tracker.settings.process_noise_position**2, rtol=0.05)
    np.testing.assert_allclose(after.covariance @ after.information, np.eye(6), atol=1e-6)


def test_a_finger_that_lets_go_is_a_reason_to_correct(can):
    tracker = tracked(can)
    last, corrections = can.observations[-1], tracker.corrections
    tracker.update(later(last, 0.02))
    assert tracker.corrections == corrections
    finger = tracker.fingertips.fingers[0]
    silent = {name: value for name, value in last.wrenches.items() if name != finger}
    tracker.update(later(last, 0.04, wrenches=silent))
    assert tracker.corrections == corrections + 1
    assert tracker.fingertips.reasons[finger] == "silent"


def test_vision_is_a_reason_to_correct(can):
    tracker = tracked(can)
    last, corrections = can.observations[-1], tracker.corrections
    vision = next(o.vision for o in reversed(can.observations) if o.vision is not None)
    tracker.update(replace(later(last, 0.02), vision=vision))
    assert tracker.corrections == corrections + 1


def test_a_set_rate_is_kept(can):
    tracker = tracked(can, rate=10.0)
    last, corrections = can.observations[-1], tracker.corrections
    for k in range(1, 101):
        tracker.update(later(last, 0.01 * k))
    assert tracker.corrections - corrections in (10, 11)


def test_a_lifted_finger_is_remembered_for_a_while(can):
    tracker = tracked(can, memory=1.0)
    last, finger = can.observations[-1], tracker.fingertips.fingers[0]
    silent = {name: value for name, value in last.wrenches.items() if name != finger}
    tracker.update(later(last, 0.5, wrenches=silent))
    assert set(tracker.track_state.touch.memory.last) - set(tracker.fingertips.fingers) == {finger}
    assert len(tracker.estimate.residuals.distance) == len(tracker.fingertips.fingers) + 1
    tracker.update(later(last, 1.4, wrenches=silent))
    tracker.update(later(last, 1.6, wrenches=silent))
    assert set(tracker.track_state.touch.memory.last) == set(tracker.fingertips.fingers)
    tracker.update(later(last, 1.7))
    assert finger in tracker.fingertips.fingers


def test_a_remembered_contact_that_does_not_fit_is_dropped(can):
    tracker = tracked(can, memory=100.0)
    last, finger = can.observations[-1], tracker.fingertips.fingers[0]
    last_contact = tracker.track_state.touch.memory.last[finger]
    kept, row = last_contact.contacts, last_contact.row
    points = kept.points_palm.copy()
    points[row] += 0.03 * kept.normals_palm[row]
    wrong = hs.Contacts(points, kept.normals_palm, covariance=kept.covariance)
    silent = {name: value for name, value in last.wrenches.items() if name != finger}
    tracker.track_state.touch.memory.last[finger] = last_contact._replace(contacts=wrong)
    tracker.update(later(last, 0.1, wrenches=silent))
    assert finger not in tracker.track_state.touch.memory.last


def test_an_object_that_is_not_grasped_stays_where_it_is_in_the_world(can):
    tracker = Tracker(can.rig, can.model)
    first = can.observations[0]
    free = {name: can.rig.fingers[name].calibration for name in can.rig.fingers}
    unloaded = {name: np.concatenate([c.bias_force, c.bias_torque]) for name, c in free.items()}
    tracker.update(replace(first, wrenches=unloaded))
    before = first.T_world_palm @ tracker.estimate.T_palm_object
    T = se3.moved(first.T_world_palm, np.array([0.1, -0.05, 0.2, 0.3, 0.1, -0.2]))
    tracker.update(later(first, 0.1, T_world_palm=T, wrenches=unloaded))
    np.testing.assert_allclose(T @ tracker.estimate.T_palm_object, before, atol=1e-9)
    assert tracker.reason == "nothing is touched: the pose is vision's"


def test_an_observation_that_comes_late_changes_nothing_and_is_counted(can):
    tracker = tracked(can)
    before = tracker.estimate
    assert tracker.update(can.observations[-3]) is before
    assert tracker.late == 1


def test_a_wrong_object_is_uncertain_and_then_lost(can):
    tracker = Tracker(can.rig, hs.ObjectModel.sphere(0.015))
    for seen in can.observations:
        tracker.update(seen)
    assert tracker.state == "uncertain"
    assert tracker.reason.startswith("the contacts do not fit the object at its estimated pose")
    for k in range(1, 4):
        tracker.update(later(can.observations[-1], 0.9 * k))
    assert tracker.state == "lost"
    assert "have fitted no pose for" in tracker.reason
    assert "another object" in tracker.reason


def test_a_pose_that_touch_got_wrong_is_dropped_when_contacts_fit_none_for_long(can):
    """Such as by a finger that met the table's edge: vision has not changed, and is enough for a new start."""
    tracker, last = tracked(can, uncertain_position=0.03), can.observations[-1]
    right = tracker.estimate.T_palm_object
    elsewhere = se3.moved(right, np.array([0.06, 0.05, -0.05, 0.2, 0.3, 0.1]))
    known = tracker.smoother.now.given_pose(elsewhere, np.diag([1e6] * 3 + [1e4] * 3))
    smoother = tracker.smoother.restarted(known)
    belief = replace(tracker.track_state.belief, smoother=smoother, table=None)
    tracker.track_state = replace(tracker.track_state, belief=belief, correction=None)
    states = []
    for k in range(1, 40):
        tracker.update(later(last, 0.1 * k))
        states.append(tracker.state)
    assert states[0] == "uncertain"
    assert states[-1] == "tracking", tracker.reason
    assert np.linalg.norm((tracker.estimate.T_palm_object - right)[:3, 3]) < 3 * tracker.sigma


def test_an_object_neither_touched_nor_detected_for_long_is_lost(can):
    tracker = tracked(can, lost_after=3.0, memory=0.0)
    for by in (3.99, 4.0):  # the second confirms the first, whose stamp jumped
        tracker.update(later(can.observations[-1], by, wrenches={}))
    assert tracker.state == "lost"
    assert tracker.reason.startswith("nothing touched and nothing seen for 4.0 s")


def test_vision_beyond_the_gate_is_left_out_until_five_in_a_row(can):
    tracker = tracked(can)
    last = can.observations[-1]
    vision = next(o.vision for o in reversed(can.observations) if o.vision is not None)
    far = PoseMeasurement(se3.moved(vision.T_frame_object, np.array([0.5, 0, 0, 0, 0, 0])), vision.frame)
    before = tracker.smoother.now.T_palm_object
    for k in range(1, 5):
        tracker.update(replace(later(last, 0.1 * k), vision=far))
        np.testing.assert_array_equal(tracker.smoother.now.T_palm_object, before)
    assert tracker.vision.rejected == 4
    tracker.update(replace(later(last, 0.5), vision=far))
    assert np.abs(tracker.smoother.now.T_palm_object - before).max() > 0.1


def test_vision_without_a_palm_to_place_it_is_counted(can):
    tracker = Tracker(can.rig, can.model)
    tracker.update(replace(can.observations[0], T_world_palm=None))
    assert tracker.vision.unplaced == 1
    assert tracker.estimate is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stamp": np.nan}, "observation.stamp: expected a finite number, got nan"),
        ({"joint_positions": {"robot0:FFJ3": 0.0}}, "joint_positions: expected a position for robot0:FFJ2"),
    ],
)
def test_an_invalid_field_of_an_observation_is_named(can, change, message):
    with pytest.raises(InvalidInput) as error:
        Tracker(can.rig, can.model).update(replace(can.observations[0], **change))
    assert message in str(error.value)


def test_a_pose_in_the_frame_of_a_missing_camera_is_refused(can):
    tracker = Tracker(replace(can.rig, camera=None), can.model)
    with refused(InvalidInput, "vision.frame"):
        tracker.update(can.observations[0])
    with refused(InvalidInput, "tracker"):
        Tracker("rig", "can")


def test_a_clock_that_was_set_back_starts_a_new_track_with_a_reason(can):
    tracker = tracked(can, uncertain_position=SHORT)
    estimate = tracker.estimate
    again = [replace(seen, stamp=seen.stamp - 100) for seen in can.observations]
    assert tracker.update(again[0]) is estimate  # it may be wrong
    tracker.update(again[1])
    assert tracker.stamp == again[1].stamp
    assert tracker.reason.startswith("the clock went back by 101.9 s: a new track")
    for seen in again[2:]:
        tracker.update(seen)
    assert tracker.state == "tracking", tracker.reason
    assert tracker.late == 0


def test_one_stamp_far_off_is_left_out(can):
    tracker, alone = Tracker(can.rig, can.model), tracked(can)
    for k, seen in enumerate(can.observations):
        if k in (30, 60):
            tracker.update(replace(seen, stamp=1e6 if k == 30 else -1e6))
        tracker.update(seen)
    np.testing.assert_array_equal(tracker.estimate.answer, alone.estimate.answer)
    assert (tracker.state, tracker.late) == (alone.state, 2)


def test_a_pause_of_the_sensors_is_no_jump_of_the_clock(can):
    tracker = tracked(can, uncertain_position=SHORT)
    last = can.observations[-1]
    for k in range(1, 6):
        paused = later(last, 5.0 * k)
        before = tracker.stamp
        assert tracker.update(paused) is tracker.estimate
        assert tracker.stamp == before  # it waits for the next one
        confirming = later(paused, 0.01)
        assert tracker.update(confirming) is tracker.estimate
        assert tracker.stamp == confirming.stamp
    assert (tracker.late, tracker.state) == (0, "tracking")


def test_observations_that_are_always_seconds_apart_are_all_used(can):
    tracker, last = tracked(can), can.observations[-1]
    used = [tracker.update(later(last, 5.0 * k)) and tracker.stamp - last.stamp for k in range(1, 7)]
    assert used == [0.0, 10.0, 10.0, 20.0, 20.0, 30.0]
    assert tracker.late == 0


@pytest.mark.parametrize("bad", [{"T_world_palm": np.full((4, 4), np.nan)}, {"stamp": 1.5}])
def test_a_tracker_is_lost_while_all_observations_are_invalid_or_late(can, bad):
    tracker = tracked(can, uncertain_position=SHORT)
    last = can.observations[-1]
    wrong = replace(later(last, 0.01), **bad)
    for _ in range(150):
        with contextlib.suppress(InvalidInput):
            tracker.update(wrong)
    assert tracker.state == "lost"
    assert tracker.reason.startswith("left out 150 observations in a row, the last: ")
    tracker.update(later(last, 0.02))
    assert tracker.state == "tracking", tracker.reason


def test_a_replay_is_right_over_clocks_that_jump(can):
    """Each observation's time is counted once, and one that is left out has no answer."""
    seen = can.observations
    span = seen[-1].stamp - seen[0].stamp
    looped = [replace(each, stamp=each.stamp - 1000) for each in seen]
    stray = replace(seen[40], stamp=1e9)
    tally, tracker = Tally(), Tracker(can.rig, can.model)
    steps = list(replay([*seen[:40], stray, *seen[40:], *looped], tracker, tally))
    # The second time round the first is used with the second, which has the answer to both.
    answered = [each.stamp for each in [*seen, *looped[1:]]]
    assert [step.stamp for step in steps] == answered
    assert tally.answered == len(steps)
    assert tally.observations == 2 * len(seen) + 1
    np.testing.assert_allclose(tally.recorded, 2 * span, atol=0.05)
    np.testing.assert_allclose(sum(tally.states.values()), tally.recorded)
    truths = Truths([(s.observation.stamp - 1000, s.T_palm_object) for s in can.samples])
    assert track_errors(can.model, steps, truths, vision=False).base[-1] < 0.004


def test_a_replay_counts_why_a_finger_never_touched(can):
    finger = "lf"
    seen = [
        replace(o, wrenches={k: v for k, v in o.wrenches.items() if k != finger}) for o in can.observations
    ]
    tally = Tally()
    list(replay(seen, Tracker(can.rig, can.model), tally))
    assert finger not in tally.touched
    assert tally.without[finger] == {"silent": len(seen)}


def test_an_arm_in_the_hands_file_gives_the_palms_pose(can):
    """The simulated hand's file has a wrist: two joints of an arm."""
    rig = replace(can.rig, world_from="joints")
    tracker = Tracker(rig, can.model)
    first = replace(can.observations[0], T_world_palm=None)
    assert tracker.update(first) is not None
    np.testing.assert_array_equal(tracker.T_world_palm, rig.hand.T_world_palm(first.joint_positions))
