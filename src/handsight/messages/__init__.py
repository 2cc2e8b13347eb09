"""ROS messages of a robot to `Observation`s: the same from a file as from a live robot.

`ObservationStream` takes one `RawMessage` (topic, type, encoding, log time, bytes) after the other and returns the
observations that are complete by then. It guarantees:

* **Time** is `header.stamp` [s]. A topic whose stamps are all 0 in its first second (or in its first message, if it
  begins later) is timed by when it was logged. Joint states are the clock of the rig.
* **Clocks**: a topic's offset is the median of log time minus stamp over the first second. An offset that differs from
  that of the joint states by more than 0.1 s is reported. By more than 0.5 s it is another clock, and the difference is
  added to the topic's stamps; but a vision pose, an image or a truth that comes up to 2 s after its stamp was slow, not
  wrong, and keeps its stamp.
* **Order**: messages are put in order of stamp in a window of 0.2 s, plus the differences of offset that were left as
  they are. Later messages are left out, and counted as late. Joint states that jump ahead by more than 1 s are bad,
  unless the next ones agree. Three in a row that are back by more than 1 s mean that the clock was set back, or that a
  recording is played in a loop: earlier messages are forgotten, and the order begins again.
* **Observations**: there is one for each joint state message, at its stamp (messages of one stamp give one), with the
  positions of all publishers of joint states (at most 0.1 s old), the newest wrench of each finger and readings of each
  tactile array (0.05 s), `T_world_palm` from /tf (each transform static or at most 0.1 s old), and the newest vision
  pose and images since the last observation (0.2 s).
* **Counted and left out** are messages of the same topic and stamp beyond the first; messages with NaN or infinity;
  messages that cannot be read as the topic's type, in an unknown frame or in a wrong unit; and readings of a sensor
  that is stuck (the same six numbers for 0.5 s while another finger's change) or at full scale.

Every message on a topic of the rig is in exactly one count of `report.topics[name]`.
"""

from handsight._deprecated import renamed
from handsight.messages.report import Report
from handsight.messages.stream import ObservationStream
from handsight.messages.topics import OwnTopic, RawMessage, RosType, TopicReport

__all__ = ["ObservationStream", "OwnTopic", "RawMessage", "Report", "RosType", "TopicReport"]

__getattr__ = renamed(__name__, {"CameraIntrinsics": "handsight.camera.Camera"})
