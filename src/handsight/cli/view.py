"""`handsight view`: a recording on a page in the browser, tracked while the page shows it."""

import contextlib
import threading
from typing import Annotated

import typer
from typer import Option

from handsight.cli import options
from handsight.cli.options import Run
from handsight.cli.terminal import FAILED, say
from handsight.cli.track import refusals
from handsight.errors import HandsightError, InvalidInput


def view(
    recording: options.RecordingPath,
    rig: options.RigPath = None,
    object: options.ObjectName = None,
    images: options.WithImages = True,
    port: Annotated[
        int, Option(min=1, max=65535, help="Port of the page; the next free one if it is taken.")
    ] = 8080,
) -> None:
    """Show a recording in the browser: the object's pose at each moment, and the evidence for it.

    The recording is tracked as by `handsight track`. The page shows the hand and the object in the palm's frame,
    contacts, forces, other likely poses, the directions that are unobservable by touch, and the camera's image; it can
    play, pause and seek. Only browsers on this machine can open it. Ctrl-C ends it.

    ```
    handsight simulate can --output can.mcap
    handsight view can.mcap
    ```
    """
    from handsight.messages import OwnTopic
    from handsight.recording.open import open_files
    from handsight.tracking import TrackerSettings
    from handsight.tracking.replay import Tally, replay
    from handsight.viewer.player import Player, require_viser

    require_viser()
    settings = TrackerSettings(images=images)
    with contextlib.suppress(KeyboardInterrupt):
        # A `track.mcap`, which has only poses, is a result and not a recording.
        is_mcap = recording.suffix == ".mcap" and recording.is_file()
        for file in open_files(recording) if is_mcap else ():
            with contextlib.closing(file):
                if set(file.topics) == {OwnTopic.POSE}:
                    expected = "expected the recording that was tracked"
                    came = "got what `handsight track` made of it: poses alone"
                    raise InvalidInput(f"{recording}: {expected}, {came}")
        run = Run.of(recording, rig, object, settings)
        title = f"{run.model.name or 'object'} in {recording.name}"
        player = Player(run.rig, run.model, port=port, title=title)
        with contextlib.closing(player), contextlib.ExitStack() as stack:
            taken = "" if player.port == port else f" ({port} is taken)"
            say(f"look at {player.address}{taken}; Ctrl-C ends")
            tally = Tally()
            opened, tracker = stack.enter_context(run.opened())
            timeline = player.timeline
            player.start()
            try:
                for _ in replay(opened.observations(), tracker, tally):
                    timeline.truth = opened.truth
                    timeline.add(tracker.track_state)
            except HandsightError as error:
                if not timeline.moments:
                    raise
                say(f"handsight: {error}")
            player.finish()
            say(*opened.report.sentences(), *refusals(tally))
            if not timeline.moments:
                say(f"no pose: {tracker.reason}")
                raise typer.Exit(FAILED)
            say(f"tracked {timeline.end:.1f} s in {tally.wall:.1f} s")
            threading.Event().wait()
