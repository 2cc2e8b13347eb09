"""A tracker on a running robot: messages as bytes in, messages as bytes out, whatever carries them.

A transport subscribes to `LiveTracker.subscriptions`, hands each message to `put` as it comes, from any thread, and
publishes the answers of `step`, which one thread calls. So nodes of ROS 1, ROS 2 and others compute the same, and the
same as `handsight track` does with a recording. It guarantees, in addition to `handsight.messages`:

* **Waiting**: joint states wait at most 2 ms for the wrenches and transforms that belong to them, and not at all for a
  camera, whose measurements count with the next joint states. `equal=True` waits through the window of 0.2 s that
  recordings have: then the answers are those of a recording of the same messages.
* **Behind**: of several joint states that are ready, only the newest is answered, and those with a pose or an image of
  the camera. `skipped` counts the others.
* **Bounds**: at most 20 000 messages and 256 MB wait; of more, the oldest are dropped, and counted.
* **The first second** is used to compare clocks: nothing is answered before it is over.
"""

from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker

__all__ = ["Answer", "LiveTracker"]
