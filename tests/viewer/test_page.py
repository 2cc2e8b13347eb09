"""The page without a browser: what is in its scene, when it is drawn, and when nothing is done."""

import contextlib
import dataclasses
import inspect
import math
import sys
import threading
import time
from collections import deque
from multiprocessing import Pipe

import numpy as np
import pytest

from handsight import ObjectModel, se3
from handsight.errors import InvalidInput, MissingExtra
from handsight.tracking import Tracker
from handsight.viewer import NullViewer, Viewer, view
from handsight.viewer.player import Player
from tests.live.recorded import answered, live, poses, said
from viewer.conftest import needs_viser


def pose(handle):
    w, x, y, z = handle.wxyz
    return se3.from_position_quaternion(handle.position, [x, y, z, w])


def messages(page):
    """How many the page has sent, or would send."""
    return page.server._websock_server._broadcast_buffer.message_counter


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_nodes_are_where_the_answer_has_them(page, tracked):
    for moment in (tracked.timeline.moments[3], tracked.timeline.moments[-1]):
        page.draw(moment)
        scene = page.scene
        np.testing.assert_allclose(pose(scene.object), moment.estimate.T_palm_object, atol=1e-9)
        assert scene.vision.visible is (moment.vision is not None)
        if moment.vision is not None:
            np.testing.assert_allclose(pose(scene.vision), moment.vision.T_palm_object, atol=1e-9)
        links = tracked.rig.hand.link_poses(moment.joint_positions)
        for name, handle in scene.links.items():
            np.testing.assert_allclose(pose(handle), links[name], atol=5e-3)
            assert handle.visible
        felt = moment.fingertips.contacts
        assert scene.contacts.visible is (felt is not None)
    np.testing.assert_allclose(scene.contacts.points, felt.points_palm, atol=2e-3)  # float16
    arrows = scene.forces.points
    np.testing.assert_allclose(arrows[:, 0], felt.points_palm, atol=5e-4)
    assert ((arrows[:, 1] - arrows[:, 0]) * felt.normals_palm).sum(axis=1).min() > 0
    assert scene.open_shifts.visible
    assert scene.turns.visible
    assert page.panel.status.content.count("TRACKING") == 1


def test_other_modes_are_ghosts(page, tracked):
    moment = tracked.timeline.moments[-1]
    estimate = moment.estimate
    other = estimate.answer.copy()
    other["T_palm_object"] = other["T_palm_object"] @ se3.compose(np.eye(3), np.array([0.03, 0.0, 0.0]))
    other["pose"]["position"] = other["T_palm_object"][:3, 3]
    other["weight"] = 0.3
    estimate = type(estimate)(estimate.answer, (estimate.answer, other), estimate.residual_rows, True)
    page.draw(dataclasses.replace(moment, estimate=estimate))
    assert [handle.visible for handle in page.scene.modes] == [True, False, False]
    np.testing.assert_allclose(pose(page.scene.modes[0]), other["T_palm_object"], atol=1e-9)
    assert "another pose is likely by 30%" in page.panel.status.content


def test_nothing_known_shows_nothing_but_the_hand(page, tracked):
    moment = tracked.timeline.moments[-1]
    nothing = dataclasses.replace(moment.fingertips, fingers=(), contacts=None)
    page.draw(moment)
    page.draw(
        dataclasses.replace(
            moment, estimate=None, vision=None, fingertips=nothing, state="lost", reason="none"
        )
    )
    scene = page.scene
    gone = (
        scene.object,
        scene.vision,
        scene.contacts,
        scene.normals,
        scene.forces,
        scene.covariance,
        scene.open_shifts,
        scene.turns,
    )
    assert not any(handle.visible for handle in gone)
    assert all(handle.visible for handle in scene.links.values())


def test_layers_that_are_switched_off_are_not_shown(page, tracked):
    page.draw(tracked.timeline.moments[-1])
    for layer in page.scene.layers:
        page.scene.layers[layer] = False
    page.redraw()
    scene = page.scene
    shown = [
        *scene.links.values(),
        scene.object,
        scene.contacts,
        scene.forces,
        scene.covariance,
        scene.open_shifts,
    ]
    assert not any(handle.visible for handle in shown)


def test_the_camera_faces_the_hand_and_the_object_with_the_world_upright(page, tracked):
    moment = tracked.timeline.moments[-1]
    page.draw(moment)
    camera = page.server.initial_camera
    places = [T[:3, 3] for T in moment.links(tracked.rig).values()] + [moment.estimate.T_palm_object[:3, 3]]
    middle = (np.min(places, axis=0) + np.max(places, axis=0)) / 2
    np.testing.assert_allclose(camera.look_at, middle)
    np.testing.assert_allclose(camera.up, moment.T_world_palm[2, :3])
    axis = (middle - camera.position) / np.linalg.norm(middle - camera.position)
    assert -0.8 < axis @ camera.up < -0.1  # from somewhat above
    half = np.max(np.linalg.norm(np.array(places) - middle, axis=1))
    assert half < np.linalg.norm(middle - camera.position) < 5 * half


def test_a_moment_that_is_drawn_again_sends_nothing_of_the_scene(page, tracked):
    moment = tracked.timeline.moments[-1]
    page.draw(moment)
    before = messages(page)
    page.scene.draw(moment, moment.forces())
    assert messages(page) == before


def test_a_frame_is_few_messages(page, tracked):
    """What a frame costs is what it sends: the hand is sent where it has moved, what is gone is not sent at all."""
    moments = tracked.timeline.moments
    page.draw(moments[0])
    before = messages(page)
    for moment in moments[1:]:
        page.draw(moment)
    assert (messages(page) - before) / (len(moments) - 1) < 50


def test_seek_shows_that_instant(page, tracked, watched):
    player = Player(page, tracked.timeline, lambda: None)
    page.draw_curves = lambda curves, now: None
    player.playing = False
    player.finish()
    player.start()
    try:
        for at in (0.8, 0.2, 0.55, 0.0, 99.0):
            player.seek(at)
            until(lambda: page.last is tracked.timeline.at(player.time))
            expected = page.last.estimate.T_palm_object
            np.testing.assert_allclose(pose(page.scene.object), expected, atol=1e-9)
        assert player.time == tracked.timeline.length
    finally:
        player.close()


def test_a_link_and_the_keys_stop_at_a_time(page, tracked, watched):
    player = Player(page, tracked.timeline, lambda: None)
    page.draw_curves = lambda curves, now: None
    player.finish()
    player.start()
    keys = {c.hotkey: c for c in page.server.gui._command_handle_from_uuid.values()}
    press = {key: command._impl.trigger_cb[-1] for key, command in keys.items()}
    try:
        for wrong in ("x", "nan"):
            page.on_open({"t": [wrong]})
        page.on_open({})
        page.on_open({"t": ["0.50"]})
        assert not player.playing
        until(lambda: page.last is tracked.timeline.at(0.5))
        shown = page.last.stamp - tracked.timeline.begin
        link = f'href="?token={page.guard.token}&amp;t={shown:.2f}"'
        until(lambda: link in page.panel.status.content)
        assert f">{shown:.2f} s</span> ·" in page.panel.status.content
        for key, time in (
            ("L", 0.6),
            ("J", 0.5),
            ("home", 0.0),
            ("J", 0.0),
            ("end", tracked.timeline.length),
        ):
            press[key](None)
            assert player.time == pytest.approx(time)
            assert not player.playing
        press["K"](None)
        assert player.playing
    finally:
        player.close()


def test_gravity_is_down_in_the_palms_frame_at_every_moment(page, tracked):
    for moment in (tracked.timeline.moments[0], tracked.timeline.moments[-1]):
        page.draw(moment)
        down = pose(page.scene.world)[:3, :3] @ [0, 0, -1]
        np.testing.assert_allclose(down, -moment.T_world_palm[2, :3], atol=5e-3)
    assert page.scene.world.visible
    page.draw(dataclasses.replace(moment, T_world_palm=None))
    assert (page.scene.world.visible, page.scene.axes.visible) == (False, True)


def test_a_browser_opened_while_paused_shows_the_moment(page, tracked, monkeypatch):
    player = Player(page, tracked.timeline, lambda: None)
    page.draw_curves = lambda curves, now: None
    player.playing = False
    player.finish()
    player.start()
    try:
        time.sleep(0.1)
        assert page.last is None
        monkeypatch.setattr(type(page), "watched", True)
        player._wake.set()  # as a browser that connects does
        until(lambda: page.last is tracked.timeline.moments[0])
    finally:
        player.close()


def test_playing_goes_through_all_moments_to_the_end_at_its_speed(page, tracked, watched):
    player = Player(page, tracked.timeline, lambda: None)
    page.draw_curves = lambda curves, now: None
    stamps = []
    page.draw = lambda moment: stamps.append(moment.stamp)
    player.finish()
    player.speed = 2.0
    began = time.monotonic()
    player.start()
    try:
        until(lambda: not player.playing)
        took = time.monotonic() - began
        assert took >= 0.95 * tracked.timeline.length / 2.0
        assert stamps == sorted(stamps)
        assert stamps[-1] == tracked.timeline.moments[-1].stamp
        player.play(True)
        assert player.playing
        assert player.time < tracked.timeline.length
    finally:
        player.close()


def test_nothing_is_drawn_while_no_browser_is_open(page, pages, tracked, free_port, monkeypatch):
    drawn = []
    monkeypatch.setattr(type(page), "draw", lambda *_: drawn.append(1))
    monkeypatch.setattr("handsight.viewer.live_viewer.Moment.now", lambda *_: drawn.append(1))
    player = Player(page, tracked.timeline, lambda: drawn.append(1))
    before = messages(page)
    player.start()
    tracker = Tracker(tracked.rig, tracked.model)
    with Viewer(tracker, port=free_port) as viewer:
        for observation in tracked.observations[:50]:
            tracker.update(observation)
            viewer.update(observation, tracker)
        of_viewer = messages(pages[-1])
        time.sleep(0.3)
        assert messages(pages[-1]) == of_viewer
    player.close()
    assert not drawn
    assert messages(page) == before
    assert player.time == 0.0


def test_the_newest_answer_is_shown_however_fast_they_come(tracked, pages, free_port, watched):
    tracker, told = Tracker(tracked.rig, tracked.model), []
    with view(tracker, port=free_port, say=told.append) as viewer:
        assert told == [f"handsight: look at {viewer.address}"]
        for observation in tracked.observations[:60]:
            tracker.update(observation)
            viewer.update(observation, tracker)
        (shown,) = pages
        until(lambda: shown.last is not None and shown.last.stamp == tracker.stamp)
        until(lambda: np.allclose(pose(shown.scene.object), tracker.estimate.T_palm_object, atol=1e-9))
        # One that comes late changes nothing, whatever is in it.
        late = dataclasses.replace(
            tracked.observations[5], wrenches={"th": np.full(6, np.nan)}, depth=np.zeros((2, 2))
        )
        tracker.update(late)
        viewer.update(late, tracker)
        assert viewer._shot is None
        other = Tracker(tracked.rig, ObjectModel.box([0.05, 0.05, 0.1]))
        other.update(tracked.observations[0])
        viewer.update(tracked.observations[0], other)
        until(lambda: shown._model.name == other.model.name and shown.last is not None)
        assert shown.last.stamp == other.stamp


def test_a_browser_opened_while_the_robot_rests_shows_the_last_estimate(
    tracked, pages, free_port, monkeypatch
):
    needs_viser()
    from handsight.viewer.page import Page

    tracker = Tracker(tracked.rig, tracked.model)
    with Viewer(tracker, port=free_port) as viewer:
        for observation in tracked.observations[:60]:
            tracker.update(observation)
            viewer.update(observation, tracker)
        (shown,) = pages
        assert shown.last is None
        monkeypatch.setattr(Page, "watched", True)
        until(lambda: shown.last is not None)
        assert shown.last.stamp == tracker.stamp
        until(lambda: viewer.watched)
        monkeypatch.setattr(Page, "watched", False)
        tracker.update(tracked.observations[60])
        viewer.update(tracked.observations[60], tracker)
        until(lambda: not viewer.watched)


def with_a_pipe(tracker, monkeypatch):
    """A viewer, and the page's end of its pipe."""

    ours, theirs = Pipe()
    from handsight.viewer import live_viewer

    monkeypatch.setattr(live_viewer, "begin", lambda: (ours, None))
    page = threading.Thread(target=lambda: (theirs.recv(), theirs.send("http://nowhere")))
    page.start()
    viewer = Viewer(tracker)
    page.join()
    return viewer, theirs


def test_title_and_plot_count_from_the_first_stamp_since_the_clock_was_set_back(tracked, monkeypatch):
    monkeypatch.setattr("handsight.viewer.live_viewer.NOTE_PERIOD", 0.0)
    tracker = Tracker(tracked.rig, tracked.model)
    viewer, theirs = with_a_pipe(tracker, monkeypatch)
    first = tracked.observations[0].stamp
    for begin in (first, first - 100.0):
        for observation in tracked.observations[:20]:
            given = dataclasses.replace(observation, stamp=observation.stamp - first + begin)
            tracker.update(given)
            viewer.update(given, tracker)
        viewer._plotted = -math.inf
        theirs.send(True)
        frame = theirs.recv()
        # A clock that was set back is believed from the second observation on.
        assert 0 <= frame.origin - begin < 3 * (given.stamp - begin) / 20
        assert frame.curves.times[0] == 0
        assert frame.curves.times[-1] == frame.moment.stamp - frame.origin
    theirs.close()
    viewer.close()


def test_a_frame_is_taken_only_when_the_page_asks_for_one(tracked, monkeypatch):
    """A page that draws slowly holds nothing up: of many answers it gets the newest, and no more than it draws."""
    tracker = Tracker(tracked.rig, tracked.model)
    viewer, theirs = with_a_pipe(tracker, monkeypatch)
    for k, observation in enumerate(tracked.observations[:90]):
        tracker.update(observation)
        viewer.update(observation, tracker)
        if k in (29, 59):
            assert not theirs.poll(0.05)
            theirs.send(True)
            frame = theirs.recv()
            assert frame.moment.stamp == tracker.stamp
            np.testing.assert_array_equal(frame.moment.estimate.T_palm_object, tracker.estimate.T_palm_object)
            assert (frame.begins, frame.shot) == (None, None)
    theirs.send(False)
    until(lambda: not viewer.watched)
    closing = threading.Thread(target=viewer.close)
    closing.start()
    assert theirs.recv() is None
    theirs.close()
    closing.join(10)
    assert not closing.is_alive()


def test_a_page_that_is_gone_ends_nothing(tracked, monkeypatch):
    tracker = Tracker(tracked.rig, tracked.model)
    viewer, theirs = with_a_pipe(tracker, monkeypatch)
    with viewer:
        theirs.send(True)
        until(lambda: viewer.watched)
        theirs.close()
        for observation in tracked.observations[:3]:
            tracker.update(observation)
            viewer.update(observation, tracker)
        until(lambda: not viewer.watched)


def test_a_nodes_tracker_is_shown_and_its_estimates_stay_the_same(pages, free_port, watched):
    messages_of_robot = said()
    alone, shown = live(equal=True), live(equal=True)  # however busy the machine is
    with view(shown.tracker, port=free_port, say=lambda _: None) as viewer:
        shown.show = viewer.update
        expected = poses(answered(alone, messages_of_robot))
        found = poses(answered(shown, messages_of_robot))
        until(lambda: pages[-1].last is not None and pages[-1].last.stamp == shown.tracker.stamp)
        place = pages[-1].last.estimate.T_palm_object
        np.testing.assert_array_equal(place, shown.tracker.estimate.T_palm_object)
    assert found
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[stamp][0], expected[stamp][0]) for stamp in expected)


def test_the_null_viewer_has_the_same_methods_and_does_nothing(tracked):
    def methods(kind):
        return {
            name: str(inspect.signature(value)) if callable(value) else ""
            for name, value in inspect.getmembers(kind)
            if not name.startswith("_") or name in ("__enter__", "__exit__")
        }

    assert methods(NullViewer) == methods(Viewer)
    with NullViewer() as nothing:
        nothing.update(tracked.observations[0], None)
        assert (nothing.address, nothing.watched) == ("", False)


def test_the_page_is_for_this_machine_and_offers_no_tunnel(page):
    psutil = pytest.importorskip("psutil")
    listening = [c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"]
    assert page.port in {address.port for address in listening}
    assert {address.ip for address in listening if address.port == page.port} == {"127.0.0.1"}
    sent = page.server._websock_server._broadcast_buffer.message_from_id.values()
    themes = [message for message in sent if type(message).__name__ == "ThemeConfigurationMessage"]
    assert [theme.show_share_button for theme in themes] == [False]


def test_a_port_that_is_taken_gives_way_to_the_next(page, tracked):
    from handsight.viewer.page import Page

    second = Page(tracked.rig, tracked.model, port=page.port)
    try:
        assert second.port != page.port
        assert second.address.startswith(f"http://127.0.0.1:{second.port}/?token=")
    finally:
        second.close()


def test_a_page_that_is_closed_leaves_no_thread(tracked, pages, free_port):
    before = {thread.name for thread in threading.enumerate()}
    with Viewer(Tracker(tracked.rig, tracked.model), port=free_port):
        pass
    # The page's own is a process, but here: its pipe is closed a moment before it ends.
    until(lambda: {thread.name for thread in threading.enumerate()} - before <= {"asyncio_0"})


def test_without_viser_one_sentence_says_what_to_install(tracked, pages, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtra, match=r"^the viewer needs viser: pip install 'handsight\[view\]'$"):
        view(Tracker(tracked.rig, tracked.model))


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_an_impossible_port_is_rejected(tracked, pages, port):
    with pytest.raises(InvalidInput, match=f"^port: expected a number from 1 to 65535, got {port}$"):
        view(Tracker(tracked.rig, tracked.model), port=port)


def test_the_states_strip_has_each_state_in_its_place(page):
    from handsight.viewer.panel import STATES
    from handsight.viewer.timeline import Curves

    times = np.linspace(0, 10, 11)
    states = ["lost"] * 3 + ["tracking"] * 8
    page.draw_curves(Curves(times, np.ones(11), None, states), 5.0)
    content = page.panel.strip.content
    assert f"{STATES['lost']} 0.00% 30.00%,{STATES['tracking']} 30.00% 100.00%" in content
    assert "left:50.00%" in content


def test_slips_are_marked_under_the_states(page):
    from handsight.viewer.panel import SLIP
    from handsight.viewer.timeline import Curves

    times = np.linspace(0, 10, 11)
    page.draw_curves(Curves(times, np.ones(11), None, ["tracking"] * 11), 5.0)
    assert SLIP not in page.panel.strip.content
    slips = [(-3.0, -2.0), (2.0, 4.5), (9.0, 9.0)]
    page.draw_curves(Curves(times, np.ones(11), None, ["tracking"] * 11, slips), 5.0)
    content = page.panel.strip.content
    assert content.count('title="slips"') == 2
    assert "left:20.00%;width:25.00%" in content
    assert "left:90.00%;width:0.00%" in content


def test_garbage_from_a_browser_ends_its_connection_without_a_traceback(page, capfd, caplog):
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    ours = [f"viser-v{viser.__version__}"]
    for frame in (b"\x00garbage", b"", "a text", b"\xc1" * 100, b"\x81\xa4type\xa1x"):
        with connect(page.address.replace("http", "ws"), subprotocols=ours) as browser:
            browser.send(frame)
            with pytest.raises(ConnectionClosed):  # after what the page sends to any browser
                deque(iter(lambda: browser.recv(timeout=20), None), maxlen=0)
    assert caplog.records == []
    assert "Traceback" not in capfd.readouterr().err
    with connect(page.address.replace("http", "ws"), subprotocols=ours) as browser:
        assert browser.recv(timeout=20)


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>", "\x1b[2J</div>", "../../x", "a" * 5000, "\ud800", ""]
)
def test_hostile_names_are_text_on_the_page(tracked, free_port, name):
    needs_viser()
    from handsight.viewer.page import Page

    moment = dataclasses.replace(tracked.timeline.moments[-1], reason=name)
    model = dataclasses.replace(tracked.model, name=name)
    with contextlib.closing(Page(tracked.rig, model, port=free_port, title=name)) as page:
        page.draw(moment)
        contents = [each.content for each in (page.panel.status, page.panel.strip, page.panel.image)]
    for content in contents:
        assert "<script" not in content
        assert "\x1b" not in content
        assert content.count("<div") == content.count("</div")
