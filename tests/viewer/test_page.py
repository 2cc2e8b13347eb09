"""The page without a browser: what is in its scene, when it is drawn, and when nothing is done."""

import contextlib
import dataclasses
import subprocess
import sys
import threading
import time
from collections import deque

import numpy as np
import pytest

from handsight import ObjectModel, se3
from handsight.errors import MissingExtra
from handsight.tracking import Tracker
from handsight.viewer import Viewer, view
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


def test_nodes_are_where_the_answer_has_them(player, tracked):
    for moment in (tracked.timeline.moments[3], tracked.timeline.moments[-1]):
        player.draw(moment)
        scene = player.scene
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
    assert player.panel.status.content.count(moment.state.upper()) == 1


def test_other_modes_are_ghosts(player, tracked):
    moment = tracked.timeline.moments[-1]
    estimate = moment.estimate
    other = estimate.modes[0].copy()
    other["T_palm_object"] = other["T_palm_object"] @ se3.compose(np.eye(3), np.array([0.03, 0.0, 0.0]))
    other["weight"] = 0.3
    both = type(estimate)(np.array([estimate.modes[0], other]), estimate.residual_rows)
    player.draw(dataclasses.replace(moment, estimate=both))
    assert [handle.visible for handle in player.scene.modes] == [True, False, False]
    np.testing.assert_allclose(pose(player.scene.modes[0]), other["T_palm_object"], atol=1e-9)


def test_what_is_not_known_and_what_is_switched_off_is_not_shown(player, tracked):
    moment, scene = tracked.timeline.moments[-1], player.scene
    nothing = dataclasses.replace(moment.fingertips, fingers=(), contacts=None)
    known = (scene.object, scene.contacts, scene.forces, scene.covariance, scene.open_shifts, scene.turns)
    player.draw(moment)
    assert all(handle.visible for handle in known)
    player.draw(dataclasses.replace(moment, estimate=None, vision=None, fingertips=nothing, state="lost"))
    assert not any(handle.visible for handle in (*known, scene.vision))
    assert all(handle.visible for handle in scene.links.values())
    player.draw(moment)
    for layer in scene.layers:
        scene.layers[layer] = False
    player.redraw()
    assert not any(handle.visible for handle in (*known, *scene.links.values()))


def test_seek_shows_that_instant(player, tracked, watched):
    player.start()
    for at in (0.8, 0.2, 0.55, 0.0, 99.0):
        player.seek(at)
        until(lambda: player.last is tracked.timeline.at(player.time))
        expected = player.last.estimate.T_palm_object
        np.testing.assert_allclose(pose(player.scene.object), expected, atol=1e-9)
        shown = player.last.stamp - tracked.timeline.origin
        assert f">{shown:.2f} s</span>" in player.panel.status.content
    assert player.time == tracked.timeline.end


def test_a_recording_plays_to_its_end_and_then_from_its_beginning(player, tracked, watched):
    player.speed = 5.0
    player.play(True)
    player.start()
    until(lambda: not player.playing)
    assert player.time == tracked.timeline.end
    player.speed = 0.0
    player.play(True)
    assert player.time == 0.0


def test_gravity_is_down_in_the_palms_frame_at_every_moment(player, tracked):
    for moment in (tracked.timeline.moments[0], tracked.timeline.moments[-1]):
        player.draw(moment)
        down = pose(player.scene.world)[:3, :3] @ [0, 0, -1]
        np.testing.assert_allclose(down, -moment.T_world_palm[2, :3], atol=5e-3)
    assert player.scene.world.visible
    player.draw(dataclasses.replace(moment, T_world_palm=None))
    assert (player.scene.world.visible, player.scene.axes.visible) == (False, True)


def test_nothing_is_drawn_while_no_browser_is_open(player, tracked, free_port, monkeypatch):
    drawn = []
    monkeypatch.setattr(type(player), "draw", lambda *_: drawn.append(1))
    monkeypatch.setattr("handsight.viewer.moment.Timeline.add", lambda *_: drawn.append(1))
    before = messages(player)
    player.play(True)
    player.start()
    tracker = Tracker(tracked.rig, tracked.model)
    with Viewer(tracker, port=free_port) as viewer:
        of_viewer = messages(viewer)
        for observation in tracked.observations[:50]:
            tracker.update(observation)
            viewer.update(tracker)
        time.sleep(0.3)
        assert messages(viewer) == of_viewer
    assert not drawn
    assert messages(player) == before
    assert player.time == 0.0


def test_the_newest_answer_is_shown_however_fast_they_come(tracked, viser, free_port, watched):
    tracker, told = Tracker(tracked.rig, tracked.model), []
    with view(tracker, port=free_port, say=told.append) as viewer:
        assert told == [f"handsight: look at {viewer.address}"]
        for observation in tracked.observations[:60]:
            tracker.update(observation)
            viewer.update(tracker)
        until(lambda: viewer.last is not None and viewer.last.stamp == tracker.stamp)
        until(lambda: np.allclose(pose(viewer.scene.object), tracker.estimate.T_palm_object, atol=1e-9))
        # One that comes late changes nothing, whatever is in it.
        late = dataclasses.replace(
            tracked.observations[5], wrenches={"th": np.full(6, np.nan)}, depth=np.zeros((2, 2))
        )
        tracker.update(late)
        viewer.update(tracker)
        assert viewer.last.picture is None
        other = Tracker(tracked.rig, ObjectModel.box([0.05, 0.05, 0.1]))
        other.update(tracked.observations[0])
        viewer.update(other)
        until(lambda: viewer.timeline.model is other.model and viewer.last is not None)
        assert viewer.last.stamp == other.stamp


def test_a_running_tracker_can_be_paused_and_its_past_looked_at(tracked, viser, free_port, watched):
    tracker = Tracker(tracked.rig, tracked.model)
    with view(tracker, port=free_port, say=lambda _: None) as viewer:
        for observation in tracked.observations[:60]:
            tracker.update(observation)
            viewer.update(tracker)
            time.sleep(0.005)
        until(lambda: viewer.last is not None and viewer.last.stamp == tracker.stamp)
        first = viewer.timeline.moments[0]
        viewer.play(False)
        viewer.seek(0.0)
        until(lambda: viewer.last is first)
        for observation in tracked.observations[60:]:
            tracker.update(observation)
            viewer.update(tracker)
        until(lambda: viewer.timeline.moments[-1].stamp == tracker.stamp)
        assert viewer.last is first
        viewer.play(True)
        until(lambda: viewer.last.stamp == tracker.stamp)


def test_images_between_two_frames_are_shown(tracked, viser, free_port, watched):
    tracker = Tracker(tracked.rig, tracked.model)
    image = np.full((48, 64, 3), 200, np.uint8)
    (first, second, *_) = tracked.observations
    with view(tracker, port=free_port, say=lambda _: None) as viewer:
        tracker.update(dataclasses.replace(first, color=image))
        viewer.update(tracker)
        tracker.update(second)
        viewer.update(tracker)
        until(lambda: viewer.last is not None and viewer.last.stamp == second.stamp)
        until(lambda: viewer.last.picture is not None)
        assert "data:image/jpeg" in viewer.panel.image.content


def test_a_nodes_tracker_is_shown_and_its_estimates_stay_the_same(viser, free_port, watched):
    messages_of_robot = said()
    alone, shown = live(equal=True), live(equal=True)  # however busy the machine is
    with view(shown.tracker, port=free_port, say=lambda _: None) as viewer:
        shown.show = viewer.update
        expected = poses(answered(alone, messages_of_robot))
        found = poses(answered(shown, messages_of_robot))
        until(lambda: viewer.last is not None and viewer.last.stamp == shown.tracker.stamp)
        place = viewer.last.estimate.T_palm_object
        np.testing.assert_array_equal(place, shown.tracker.estimate.T_palm_object)
    assert found
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[stamp][0], expected[stamp][0]) for stamp in expected)


def test_the_page_is_for_this_machine_and_offers_no_tunnel(player):
    psutil = pytest.importorskip("psutil")
    listening = [c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"]
    assert player.port in {address.port for address in listening}
    assert {address.ip for address in listening if address.port == player.port} == {"127.0.0.1"}
    sent = player.server._websock_server._broadcast_buffer.message_from_id.values()
    themes = [message for message in sent if type(message).__name__ == "ThemeConfigurationMessage"]
    assert [theme.show_share_button for theme in themes] == [False]


def test_a_port_that_is_taken_gives_way_to_the_next(player, tracked):
    from handsight.viewer.player import Player

    second = Player(tracked.rig, tracked.model, port=player.port)
    try:
        assert second.port != player.port
        assert second.address.startswith(f"http://127.0.0.1:{second.port}/?token=")
    finally:
        second.close()


def test_a_page_that_is_closed_leaves_no_thread(tracked, viser, free_port):
    before = {thread.name for thread in threading.enumerate()}
    with Viewer(Tracker(tracked.rig, tracked.model), port=free_port):
        pass
    until(lambda: {thread.name for thread in threading.enumerate()} - before <= {"asyncio_0"})


PROGRAM = """
import handsight as hs
from handsight.cli.demo import DATA

rig = hs.Rig.from_file(DATA / "can.rig.yaml")
hs.view(hs.Tracker(rig, rig.objects["can"].model()), say=lambda _: None)
"""


@pytest.mark.slow
def test_a_program_that_does_not_close_its_page_ends_in_silence(viser):
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=300)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


def test_without_viser_one_sentence_says_what_to_install(tracked, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with refused(MissingExtra, "the viewer needs viser"):
        view(Tracker(tracked.rig, tracked.model))


def test_garbage_from_a_browser_ends_its_connection_without_a_traceback(player, capfd, caplog):
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    ours = [f"viser-v{viser.__version__}"]
    for frame in (b"\x00garbage", b"", "a text", b"\xc1" * 100, b"\x81\xa4type\xa1x"):
        with connect(player.address.replace("http", "ws"), subprotocols=ours) as browser:
            browser.send(frame)
            with pytest.raises(ConnectionClosed):  # after what the page sends to any browser
                deque(iter(lambda: browser.recv(timeout=20), None), maxlen=0)
    assert caplog.records == []
    assert "Traceback" not in capfd.readouterr().err
    with connect(player.address.replace("http", "ws"), subprotocols=ours) as browser:
        assert browser.recv(timeout=20)


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>", "\x1b[2J</div>", "../../x", "a" * 5000, "\ud800", ""]
)
def test_hostile_names_are_text_on_the_page(viser, tracked, free_port, name):
    from handsight.viewer.player import Player

    moment = dataclasses.replace(tracked.timeline.moments[-1], reason=name)
    model = dataclasses.replace(tracked.model, name=name)
    with contextlib.closing(Player(tracked.rig, model, port=free_port, title=name)) as player:
        player.draw(moment)
        contents = [each.content for each in (player.panel.status, player.panel.image)]
    for content in contents:
        assert "<script" not in content
        assert "\x1b" not in content
        assert content.count("<div") == content.count("</div")
