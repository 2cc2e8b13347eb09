"""The page in a browser: it loads, the object moves when the recording plays, and the slider seeks."""

import shutil
import time

import numpy as np
import pytest

from handsight import se3
from handsight.viewer.scene import quaternions_wxyz

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-quic"),
)
PATIENCE = 120.0
"""Software draws the page in seconds, of a busy machine in many [s]."""


@pytest.fixture
def browser(viser):
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the browser needs playwright (handsight[dev])"
    )
    if CHROMIUM is None:
        pytest.skip("needs a browser: Debian's package chromium")
    with playwright.sync_playwright() as running:
        made = running.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield made
        made.close()


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def amber(player):
    """(2,) column and row of the middle of what is drawn in the object's colour, from a camera that stands still."""
    (client,), camera = player.server.get_clients().values(), player.server.initial_camera
    forward = camera.look_at - camera.position
    right = np.cross(forward, camera.up)
    axes = [axis / np.linalg.norm(axis) for axis in (right, np.cross(forward, right), forward)]
    turned = quaternions_wxyz(se3.compose(np.stack(axes, axis=1), np.zeros(3)))
    end, rows = time.monotonic() + PATIENCE, np.empty(0)
    while len(rows) <= 50:  # a browser draws what it was sent when it has time
        assert time.monotonic() < end, "nothing is drawn in the colour of the object"
        image = client.get_render(height=120, width=160, position=camera.position, wxyz=turned, fov=1.0)
        red, green, blue = image[..., :3].astype(int).transpose(2, 0, 1)
        rows, columns = np.nonzero((red - blue > 60) & (red - green > 10) & (green - blue > 30))
    return np.array([columns.mean(), rows.mean()])


@pytest.mark.slow
def test_the_object_moves_as_the_recording_plays_and_the_slider_seeks(browser, player):
    timeline = player.timeline
    player.start()
    tab = browser.new_page(viewport={"width": 480, "height": 320})
    tab.set_default_timeout(1e3 * PATIENCE)
    asked = []
    tab.on("request", lambda request: asked.append(request.url))
    try:
        tab.goto(player.address)
        until(lambda: player.watched and player.last is timeline.moments[0])
        tab.wait_for_selector("canvas")
        began = amber(player)

        player.play(True)
        until(lambda: not player.playing)
        # Vision's first pose is centimetres off. The browser draws what it was sent when it has time.
        until(lambda: np.linalg.norm(amber(player) - began) > 3)
        time.sleep(1.0)
        ended = amber(player)

        thumb = tab.get_by_role("slider").first
        thumb.press("Home")
        until(lambda: player.last is timeline.moments[0])
        until(lambda: np.abs(amber(player) - began).max() < 1.0)
        thumb.press("End")
        until(lambda: player.last is timeline.moments[-1])
        until(lambda: np.abs(amber(player) - ended).max() < 1.0)

        # Whoever else looks sees the same moment, and may choose another for both.
        other = browser.new_page(viewport={"width": 480, "height": 320})
        other.set_default_timeout(1e3 * PATIENCE)
        other.goto(player.address)
        theirs = other.get_by_role("slider").first
        until(lambda: float(theirs.get_attribute("aria-valuenow")) > 0.9 * timeline.end)
        theirs.press("Home")
        until(lambda: player.last is timeline.moments[0])
        until(lambda: float(thumb.get_attribute("aria-valuenow")) == 0)
        assert all(url.startswith((f"http://127.0.0.1:{player.port}/", "data:", "blob:")) for url in asked)
    finally:
        tab.close()
