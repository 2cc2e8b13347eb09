"""`handsight view`: a recording on a page, tracked as it is shown."""

import contextlib
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handsight.cli.options import (
    ObjectName,
    Recorded,
    RigFile,
    rig_and_object,
    with_intrinsics,
    with_settings,
)
from handsight.cli.terminal import FAILED, announce_compiling, say
from handsight.cli.track_summary import refusals
from handsight.errors import HandsightError, InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings
    from handsight.viewer.page import Page


@with_settings
def view(
    recording: Recorded,
    rig: RigFile = None,
    object: ObjectName = None,
    *,
    settings: "TrackerSettings",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Of the page; where it is taken, the next one that is free.")
    ] = 8080,
) -> None:
    """Show a recording in the browser, tracked as `handsight track` does: what is believed at each moment, and why.

    Hand and object as they lie in the palm, contacts, forces, other likely poses, what touch leaves open, the camera's
    image; play, pause and seek. The page is for browsers of this machine only. Ctrl-C ends it.

    ```
    handsight simulate can --output can.mcap
    handsight view can.mcap
    ```
    """
    from handsight.viewer.page import Page, require_viser

    require_viser()
    announce_compiling()
    with contextlib.suppress(KeyboardInterrupt):
        refuse_track(recording)
        found, model = rig_and_object(recording, rig, object)
        page = Page(found, model, port=port, title=f"{model.name or 'object'} in {recording.name}")
        with contextlib.closing(page):
            taken = "" if page.port == port else f" ({port} is taken)"
            say(f"look at {page.address}{taken}; Ctrl-C ends")
            show(recording, found, model, settings, page)


def refuse_track(path: Path) -> None:
    """Raises InvalidInput for a `track.mcap`: what moved the hand, and what it touched, are not in it."""
    from handsight.recording.open import open_files
    from handsight.recording.write import TRACK_TOPIC

    if path.suffix != ".mcap" or not path.is_file():
        return
    for file in open_files(path):
        with contextlib.closing(file):
            if set(file.topics) == {TRACK_TOPIC}:
                raise InvalidInput(
                    f"{path}: expected the recording that was tracked, "
                    "got what `handsight track` made of it: poses alone"
                )


def show(path: Path, rig: "Rig", model: "ObjectModel", settings: "TrackerSettings", page: "Page") -> None:
    """Tracks a recording while its page plays it; then waits for Ctrl-C. Exits with 1 where there is no pose."""
    from handsight.evaluation import Truths
    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Tally
    from handsight.viewer.player import Player
    from handsight.viewer.timeline import Timeline, curves, follow

    with open_recording(path, rig) as recording:
        rig = with_intrinsics(rig, recording)
    tracker, timeline, tally = Tracker(rig, model, settings=settings), Timeline(), Tally()
    with open_recording(path, rig) as recording:
        player = Player(page, timeline, lambda: curves(timeline.moments, model, Truths(recording.truth)))
        with contextlib.closing(player):
            player.start()
            try:
                for _ in follow(recording.observations(), tracker, tally, timeline):
                    pass
            except HandsightError as error:
                if not timeline.moments:
                    raise
                say(f"handsight: {error}")
            player.finish()
            for sentence in (*recording.report.sentences(), *refusals(tally)):
                say(sentence)
            if not timeline.moments:
                say(f"no pose: {tracker.reason}")
                raise typer.Exit(FAILED)
            say(f"tracked {timeline.length:.1f} s in {tally.wall:.1f} s")
            threading.Event().wait()
