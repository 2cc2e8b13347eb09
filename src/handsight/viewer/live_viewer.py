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


class Viewer(Player):
    """Shows the newest estimate of a tracker, at most 30 times a second, and the last minute when it is paused.

    It may be updated at any rate, draws in a thread, and does nothing while nobody watches.
    """

    def __init__(self, tracker: Tracker, *, port: int = PAGE_PORT) -> None:
        """See `view`."""
        super().__init__(tracker.rig, tracker.model, port=port, title=tracker.model.name, live=True)
        self._tracker = tracker
        self._with_images: TrackState | None = None  # the newest state after images
        self.start()

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

    def take(self) -> None:
        """Adds the newest state to the timeline."""
        tracker = self._tracker
        state = tracker.track_state
        images = self._with_images
        if self.timeline.rig is not tracker.rig or self.timeline.model is not tracker.model:
            self.begin(tracker.rig, tracker.model, tracker.model.name)
            images = self._with_images = None
        if images is not None:
            self.timeline.see(images)
        moments = self.timeline.moments
        if state.processed is not None and (not moments or state.stamp != moments[-1].stamp):
            self.timeline.add(state)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
