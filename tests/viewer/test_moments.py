"""What is shown of an answer says what the answer says."""

import dataclasses
import math

import numpy as np
import pytest

from handsight import ObjectModel, PoseEstimate, contact_from_wrench, se3
from handsight.contact import compensate
from handsight.evaluation import Truths, track_errors
from handsight.observation import Observation
from handsight.tracking import Tracker
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.replay import Tally, replay
from handsight.viewer.moment import MOMENT_PERIOD, Timeline
from handsight.viewer.picture import picture
from handsight.viewer.shapes import SIGMAS_95, ellipsoid, middle, open_direction


def touched(tracked):
    """The last moment, in which all fingers touch."""
    return tracked.timeline.moments[-1]


def test_a_recording_is_shown_as_track_gives_it(tracked):
    steps = {s.stamp: s for s in replay(tracked.observations, Tracker(tracked.rig, tracked.model), Tally())}
    moments = tracked.timeline.moments
    assert len(moments) > 20
    for moment in moments:
        step = steps[moment.stamp]
        np.testing.assert_array_equal(moment.estimate.T_palm_object, step.estimate.T_palm_object)
        assert (moment.state, moment.sigma, moment.fingertips.fingers) == (
            step.state,
            step.sigma,
            step.fingers,
        )
    between = np.diff([moment.stamp for moment in moments])
    assert min(between[:-1]) >= MOMENT_PERIOD - 1e-3
    assert moments[-1].stamp == tracked.observations[-1].stamp  # the newest is always there


def observed(tracked, moment):
    (observation,) = (each for each in tracked.observations if each.stamp == moment.stamp)
    return observation


def test_forces_are_those_that_contacts_are_sensed_from(tracked):
    moment, rig = touched(tracked), tracked.rig
    observation, felt = observed(tracked, moment), moment.fingertips
    assert set(moment.forces()) == set(felt.fingers)
    # The tracker's have the joints' known offsets in them; these have none.
    sensed = FingertipSensors(rig).contacts(observation)
    forces = dataclasses.replace(moment, fingertips=sensed).forces()
    assert set(forces) == set(felt.fingers)
    assert len(forces) >= 4
    T_palm_world = se3.inverse(moment.T_world_palm)
    Ts = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(moment.joint_positions), strict=True))
    for name, point in zip(felt.fingers, felt.contacts.points_palm, strict=True):
        finger = rig.fingers[name]
        T_palm_surface = Ts[name] @ finger.T_frame_surface
        T_sensor_palm = se3.inverse(T_palm_surface @ finger.tip.T_surface_sensor)
        gravity = T_sensor_palm[:3, :3] @ T_palm_world[:3, :3] @ rig.gravity
        reading = observation.wrenches[name]
        wrench = compensate(reading[:3], reading[3:], gravity, finger.calibration)
        contact = contact_from_wrench(*wrench, finger.tip).moved(T_palm_surface)
        np.testing.assert_allclose(forces[name], contact.force, atol=1e-9)
        np.testing.assert_allclose(point, contact.point, atol=2e-3)  # the joints' known offsets are in it


def test_a_moment_without_joints_has_no_link_but_the_palm_and_no_forces(tracked):
    moment = touched(tracked)
    unknown = dataclasses.replace(observed(tracked, moment), joint_positions=None)
    felt = FingertipSensors(tracked.rig).contacts(unknown)
    blind = dataclasses.replace(moment, joint_positions=None, fingertips=felt)
    assert list(blind.links(tracked.rig)) == ["robot0:palm"]
    assert blind.forces() == {}


def test_the_timeline_gives_the_last_moment_that_is_not_later(tracked):
    timeline = tracked.timeline
    rng, stamps = np.random.default_rng(3), np.array([m.stamp for m in timeline.moments])
    for time in (*(stamps - stamps[0]), *rng.uniform(-0.1, timeline.end + 0.1, 50)):
        expected = np.flatnonzero(stamps <= stamps[0] + max(time, 0.0) + 1e-3)[-1]
        assert timeline.at(time) is timeline.moments[expected]


def test_curves_are_the_sigmas_and_errors_of_the_estimates(tracked):
    timeline = tracked.timeline
    moments, model = timeline.moments, tracked.model
    found = timeline.curves()
    steps = replay(tracked.observations, Tracker(tracked.rig, model), Tally())
    kept = {m.stamp for m in moments}
    steps = [step for step in steps if step.stamp in kept]
    expected = track_errors(model, steps, Truths(timeline.truth), vision=False).middle
    np.testing.assert_allclose(found.errors[np.isfinite(found.errors)], 1e3 * expected, atol=1e-9)
    np.testing.assert_allclose(found.sigmas, [1e3 * step.sigma for step in steps])
    assert list(found.states) == [step.state for step in steps]
    np.testing.assert_allclose(found.times, np.array(sorted(kept)) - moments[0].stamp)


def test_a_plot_has_few_points_and_every_slip(tracked):
    timeline = Timeline(tracked.rig, tracked.model)
    first = tracked.timeline.moments[-1]
    timeline.moments = [dataclasses.replace(first, stamp=0.1 * k) for k in range(2000)]
    slips = dataclasses.replace(first.slip, slipping=True)
    timeline.moments[1003] = dataclasses.replace(first, stamp=100.3, slip=slips)
    few = timeline.curves()
    assert len(few.times) <= 300
    assert (few.times[0], few.times[-1]) == (0.0, pytest.approx(199.9))
    (slipping,) = np.flatnonzero(few.slipping)
    assert few.times[slipping] <= 100.3 < few.times[slipping + 1]


def states(tracked, count):
    """The states after the first observations."""
    tracker = Tracker(tracked.rig, tracked.model)
    for observation in tracked.observations[:count]:
        tracker.update(observation)
        yield tracker.track_state


def test_a_timeline_begins_anew_where_the_clock_was_set_back_and_keeps_no_more_than_asked(tracked):
    timeline = Timeline(tracked.rig, tracked.model, most=4)
    known = list(states(tracked, 40))
    for state in known:
        timeline.add(state)
        assert timeline.moments[-1].stamp == state.stamp
    assert len(timeline.moments) == 4
    assert timeline.origin == known[0].stamp
    assert timeline.begin == timeline.moments[0].stamp - timeline.origin
    timeline.add(known[10])
    assert [moment.stamp for moment in timeline.moments] == [known[10].stamp]
    assert (timeline.origin, timeline.begin, timeline.end) == (known[10].stamp, 0.0, 0.0)


def test_the_ellipsoid_contains_95_of_100_draws_of_the_middle():
    model, rng = ObjectModel.box([0.04, 0.06, 0.1]), np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * np.repeat([1e-3, 1e-2], 3)[:, None]
    T = se3.random(rng, spread=0.1)
    estimate = PoseEstimate.from_gaussian(T, root @ root.T, np.zeros((0, 6)))
    T_palm_axes, semi_axes = ellipsoid(estimate, model)
    np.testing.assert_allclose(T_palm_axes[:3, 3], middle(model, T))
    assert np.linalg.det(T_palm_axes[:3, :3]) == pytest.approx(1)
    draws = (root @ rng.normal(size=(6, 4000))).T
    places = np.array([middle(model, se3.moved(T, draw)) for draw in draws])
    inside = se3.apply(se3.inverse(T_palm_axes), places) / semi_axes
    assert (np.linalg.norm(inside, axis=1) < 1).mean() == pytest.approx(0.95, abs=0.012)
    assert pytest.approx(math.sqrt(7.8147), abs=1e-3) == SIGMAS_95


@pytest.mark.parametrize("seed", range(5))
def test_a_slide_is_drawn_along_and_a_turn_about_its_direction(seed):
    model, rng = ObjectModel.cylinder(0.03, 0.1), np.random.default_rng(seed)
    axis, center = rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    arrows, arc = open_direction(np.r_[axis, 0, 0, 0], center, model)
    assert not len(arc)
    np.testing.assert_allclose(np.cross(arrows[:, 1] - arrows[:, 0], axis), 0, atol=1e-12)
    np.testing.assert_allclose(arrows[:, 1].mean(axis=0), center)
    arrows, turn = open_direction(np.r_[0, 0, 0, axis], center, model)
    np.testing.assert_allclose((turn - center) @ axis, 0, atol=1e-12)
    radii = np.linalg.norm(turn - center, axis=1)
    np.testing.assert_allclose(radii, radii[0])
    np.testing.assert_array_equal(arrows[0, 1], turn[-1])
    # The arrow's head is at the end that a positive turn goes to.
    assert np.cross(turn[0] - center, turn[1] - center) @ axis > 0


def seen(tracked):
    """The built-in picture, as an observation of a rig whose camera is on the palm."""
    import json

    from handsight.cli.demo import DATA
    from handsight.cli.demo import picture as frame_of

    known = json.loads((DATA / "can.picture.json").read_bytes())
    frame = frame_of(tracked.rig, known)
    T_camera_palm = se3.from_position_quaternion(**known["T_camera_palm"])
    camera = dataclasses.replace(
        tracked.rig.camera,
        on="palm",
        T_mount_camera=se3.inverse(T_camera_palm),
        intrinsics=frame.camera.matrix,
        size=frame.camera.size,
        lens=frame.camera.lens,
    )
    rig = dataclasses.replace(tracked.rig, camera=camera)
    truth = se3.from_position_quaternion(**known["truth"])
    return rig, Observation(0.0, depth=frame.depth, color=frame.color), se3.inverse(T_camera_palm) @ truth


def test_the_outline_is_around_the_object_and_the_cloud_on_it(tracked):
    pytest.importorskip("PIL")
    rig, observation, T_palm_object = seen(tracked)
    state = dataclasses.replace(Tracker(rig, tracked.model).track_state, processed=observation)
    found, amber = picture(rig, state), (224, 161, 0)
    image = found.with_outlines(tracked.model, {amber: found.T_camera_palm @ T_palm_object})
    outline = (image == amber).all(axis=2)
    assert outline.sum() > 100
    points, _ = tracked.model.sample(2000)
    points = points * 0.94  # a pixel within
    inside = np.zeros_like(outline)
    columns, rows = (
        np.round(found.camera.project(se3.apply(found.T_camera_palm @ T_palm_object, points))).astype(int).T
    )
    inside[rows, columns] = True
    from scipy.ndimage import binary_dilation

    assert not (outline & inside).any()
    assert (outline <= binary_dilation(inside, iterations=8)).all()
    # The can is in the picture: many of its depths are on the surface that is drawn there.
    off = tracked.model.evaluate(se3.apply(se3.inverse(T_palm_object), found.points_palm)).distance
    assert (np.abs(off) < 0.004).sum() > 150


def test_a_moment_is_the_trackers_state(tracked):
    timeline = Timeline(tracked.rig, tracked.model)
    for state in states(tracked, 60):
        timeline.add(state)
        moment = timeline.moments[-1]
        assert (moment.stamp, moment.state, moment.reason) == (
            state.stamp,
            state.monitor.label,
            state.monitor.reason,
        )
        assert moment.estimate is state.estimate
        assert moment.fingertips is state.touch.fingertips
