"""The page without a browser: what is in its scene, when it is drawn, and when nothing is done."""

import contextlib
import dataclasses
import sys
import threading
import time
from collections import deque
from multiprocessing import Pipe

import numpy as np
import pytest

from handsight import ObjectModel, se3
from handsight.errors import MissingExtra
from handsight.tracking import Tracker
from handsight.viewer import Viewer, view
from handsight.viewer.player import Player
from testbed.refusals import refused
from tests.live.recorded import answered, live, poses, said


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
    assert page.panel.status.content.count(moment.state.upper()) == 1


def test_other_modes_are_ghosts(page, tracked):
    moment = tracked.timeline.moments[-1]
    estimate = moment.estimate
    other = estimate.modes[0].copy()
    other["T_palm_object"] = other["T_palm_object"] @ se3.compose(np.eye(3), np.array([0.03, 0.0, 0.0]))
    other["weight"] = 0.3
    both = type(estimate)(np.array([estimate.modes[0], other]), estimate.residual_rows)
    page.draw(dataclasses.replace(moment, estimate=both))
    assert [handle.visible for handle in page.scene.modes] == [True, False, False]
    np.testing.assert_allclose(pose(page.scene.modes[0]), other["T_palm_object"], atol=1e-9)


def test_what_is_not_known_and_what_is_switched_off_is_not_shown(page, tracked):
    moment, scene = tracked.timeline.moments[-1], page.scene
    nothing = dataclasses.replace(moment.fingertips, fingers=(), contacts=None)
    known = (scene.object, scene.contacts, scene.forces, scene.covariance, scene.open_shifts, scene.turns)
    page.draw(moment)
    assert all(handle.visible for handle in known)
    page.draw(dataclasses.replace(moment, estimate=None, vision=None, fingertips=nothing, state="lost"))
    assert not any(handle.visible for handle in (*known, scene.vision))
    assert all(handle.visible for handle in scene.links.values())
    page.draw(moment)
    for layer in scene.layers:
        scene.layers[layer] = False
    page.redraw()
    assert not any(handle.visible for handle in (*known, *scene.links.values()))


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


def test_keys_play_and_step(page, tracked, watched):
    player = Player(page, tracked.timeline, lambda: None)
    page.draw_curves = lambda curves, now: None
    player.playing = False
    player.finish()
    player.start()
    keys = {c.hotkey: c for c in page.server.gui._command_handle_from_uuid.values()}
    press = {key: command._impl.trigger_cb[-1] for key, command in keys.items()}
    try:
        player.seek(0.5)
        for key, time in (("L", 0.6), ("J", 0.5)):
            press[key](None)
            assert player.time == pytest.approx(time)
            assert not player.playing
            until(lambda time=time: page.last is tracked.timeline.at(time))
            shown = page.last.stamp - tracked.timeline.begin  # of the last moment that is not later
            assert shown == pytest.approx(time, abs=0.05)
            assert f">{shown:.2f} s</span>" in page.panel.status.content
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
        assert shown.last.picture is None
        other = Tracker(tracked.rig, ObjectModel.box([0.05, 0.05, 0.1]))
        other.update(tracked.observations[0])
        viewer.update(tracked.observations[0], other)
        until(lambda: shown._model.name == other.model.name and shown.last is not None)
        assert shown.last.stamp == other.stamp


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
    with refused(MissingExtra, "the viewer needs viser"):
        view(Tracker(tracked.rig, tracked.model))


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
def test_hostile_names_are_text_on_the_page(viser, tracked, free_port, name):
    from handsight.viewer.page import Page

    moment = dataclasses.replace(tracked.timeline.moments[-1], reason=name)
    model = dataclasses.replace(tracked.model, name=name)
    with contextlib.closing(Page(tracked.rig, model, port=free_port, title=name)) as page:
        page.draw(moment)
        contents = [each.content for each in (page.panel.status, page.panel.image)]
    for content in contents:
        assert "<script" not in content
        assert "\x1b" not in content
        assert content.count("<div") == content.count("</div")
