"""A recording's way through a tracker as moments to be shown."""

from collections import deque
from collections.abc import Iterable, Iterator

from handsight.observation import Observation
from handsight.tracking import Tracker
from handsight.tracking.clock import MAX_UNCONFIRMED
from handsight.tracking.replay import Tally, replay
from handsight.viewer.moment import Moment
from handsight.viewer.picture import Picture, picture
from handsight.viewer.player import Timeline

PICTURES_EVERY = 0.1
"""Between two images that are kept [s]: each takes 40 kB."""


def follow(
    observations: Iterable[Observation], tracker: Tracker, tally: Tally, timeline: Timeline
) -> Iterator[Moment]:
    """Fills a timeline with the tracker's answers, the same as `handsight track` gives; each moment that is kept."""
    taken = deque[Observation](maxlen=MAX_UNCONFIRMED + 2)  # an answer may wait for so many
    last, waiting = None, list[Picture]()

    def heard() -> Iterator[Observation]:
        for observation in observations:
            taken.append(observation)
            yield observation

    pictured = -float("inf")
    for step in replay(heard(), tracker, tally):
        observation = next(o for o in reversed(taken) if o.stamp == step.stamp)
        if step.stamp - pictured >= PICTURES_EVERY:
            image = picture(tracker.rig, observation, tracker.vision.camera_from_palm, step.T_world_palm)
            if image is not None:
                pictured, waiting = step.stamp, [image.packed()]
        moment = Moment.of(step, observation).after(last, waiting[0] if waiting else None)
        if timeline.append(moment):
            last, waiting = moment, []
            yield moment
