"""The page of a tracker that runs, by `view(tracker)`."""

from collections.abc import Callable
from typing import Self

from handsight.tracking import Tracker
from handsight.tracking.track_state import TrackState
from handsight.viewer.player import PAGE_PORT, Player


def view(tracker: Tracker, *, port: int = PAGE_PORT, say: Callable[[str], None] = print) -> "Viewer":
    """Returns a page that shows a tracker at work in any browser of this machine; `Viewer.update` shows its newest
    estimate.

    ```
    tracker = hs.Tracker(rig, model)
    viewer = hs.view(tracker)
    for observation in robot:
        tracker.update(observation)
        viewer.update(tracker)
    ```

    `say` is called with a sentence that has the page's address; if `port` is taken, the next free one is used. Raises
    MissingExtra without viser.
    """
    viewer = Viewer(tracker, port=port)
    say(f"handsight: look at {viewer.address}")
    return viewer


class Viewer:
    """Shows the newest estimate of a tracker, at most 30 times a second, and the last minute when it is paused.

    It may be updated at any rate, draws in a thread, and does nothing while nobody watches.
    """

    def __init__(self, tracker: Tracker, *, port: int = PAGE_PORT) -> None:
        """See `view`."""
        self._tracker = tracker
        self._with_images: TrackState | None = None  # the newest state after images
        self._player = Player(
            tracker.rig, tracker.model, port=port, title=tracker.model.name, take=self._take
        )
        self.address = self._player.address
        """Address of the page for a browser."""
        self._player.start()

    def update(self, tracker: Tracker) -> None:
        """Shows a tracker's estimate.

        Its last observation's arrays must not be changed afterwards. The tracker may be another one than before, of
        another object too: the page is then cleared.
        """
        state = tracker.track_state
        seen = state.processed
        if seen is not None and (seen.color is not None or seen.depth is not None):
            self._with_images = state
        self._tracker = tracker

    def close(self) -> None:
        """Ends the page."""
        self._player.close()

    def _take(self) -> None:
        """Adds the newest state to the page's timeline."""
        tracker = self._tracker
        state = tracker.track_state
        images = self._with_images
        timeline = self._player.timeline
        if timeline.rig is not tracker.rig or timeline.model is not tracker.model:
            self._player.begin(tracker.rig, tracker.model, tracker.model.name)
            timeline = self._player.timeline
            images = self._with_images = None
        if images is not None:
            timeline.see(images)
        if state.processed is not None and (
            not timeline.moments or state.stamp != timeline.moments[-1].stamp
        ):
            timeline.add(state)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
