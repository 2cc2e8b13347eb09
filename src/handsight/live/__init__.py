"""A tracker on a robot that runs: messages as bytes in, messages as bytes out, whatever carries them.

A transport subscribes to `LiveTracker.subscriptions`, hands each message to `put` as it comes, from any thread, and
publishes what `step` answers, from one. So nodes of ROS 1, ROS 2 and others compute the same, and the same as
`handsight track` does with a recording. What may be relied on beyond `handsight.messages`:

* **Waiting**: joint states wait at most 2 ms for the wrenches and transforms that belong to them, and for a camera not
  at all: its word counts with the next joint states. `equal=True` waits through the files' window of 0.2 s: then the
  answers are those of a recording of the same messages.
* **Behind**: of several joint states that are ready, only the newest is answered, but none with a pose or an image of
  the camera is passed over. `skipped` counts the others.
* **Bounds**: what waits is at most 20 000 messages and 256 MB; of more the oldest are dropped, and counted.
* **The first second** goes to comparing clocks: nothing is answered before.
"""

from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker

__all__ = ["Answer", "LiveTracker"]
