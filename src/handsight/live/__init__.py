"""A tracker on a running robot: serialised messages in, serialised messages out, independent of the transport.

A transport subscribes to `LiveTracker.subscriptions`, calls `put` with each message that comes, from any thread, and
publishes the answers of `step`, which a single thread calls. So nodes of ROS 1, ROS 2 and others give the same poses,
and the same as `handsight track` for a recording. In addition to `handsight.messages`, it guarantees:

* **Waiting**: joint states wait at most 2 ms for the wrenches and transforms that belong to them, and not at all for a
  camera, whose measurements are used with the next joint states. With `equal=True` they wait through the window of
  0.2 s that recordings have, and the answers equal those for a recording of the same messages.
* **Falling behind**: if several joint states are ready, only the newest is answered, and those with a camera's pose or
  image. `skipped` counts the others.
* **Bounds**: at most 20 000 messages and 256 MB wait; beyond that the oldest are dropped and counted.
* **The beginning**: the answers begin when joint states have come for 0.1 s, which shows what else comes.
"""

from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker

__all__ = ["Answer", "LiveTracker"]
