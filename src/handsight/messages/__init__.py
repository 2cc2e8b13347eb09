"""ROS messages of a robot to `Observation`s: the same from a file as from a live robot.

`ObservationStream` takes one `RawMessage` (topic, type, encoding, log time, bytes) after the other and returns the
observations that are complete by then. It guarantees:

* **Time** is `header.stamp` [s]. A topic whose stamps are all 0 in its first second (or in its first message, if it
  begins later) is timed by when it was logged. Joint states are the clock of the rig.
* **Clocks**: a topic's offset is the median of log time minus stamp over the first second. One that differs from the
  joint states' by more than 0.1 s is reported. By more than 0.5 s it is another clock, and the topic's stamps are
  shifted by the difference; but a vision pose, an image or a truth that comes up to 2 s later than its stamp was slow,
  not wrong, and keeps it.
* **Order**: messages are put in order of stamp through a window of 0.2 s (and the differences of offset that were
  left as they are). What comes later than that is dropped, and counted as late. Joint states that jump ahead by more
  than 1 s must agree with the next ones, else they are bad. Three in a row that are back by more than 1 s mean that the
  clock was set back, or that a recording is played in a loop: earlier messages are forgotten, and all begins anew.
* **Observations**: one per joint state message, at its stamp (messages of one stamp give one), with the positions of
  all that publish joint states (at most 0.1 s old), the newest wrench of each finger and readings of each tactile
  array (0.05 s), `T_world_palm` from /tf (each transform static or 0.1 s), and the newest vision pose and images since
  the last one (0.2 s).
* **Counted and left out**: messages of the same topic and stamp beyond the first; messages with NaN or infinity; what
  cannot be read as its topic's type, in an unknown frame or a wrong unit; readings of a sensor that is stuck (the
  same six numbers for 0.5 s while another finger's change) or at full scale.

Every message on a topic of the rig is in exactly one count of `report.topics[name]`.
"""

from handsight.messages.report import Report
from handsight.messages.stream import ObservationStream
from handsight.messages.topics import OwnTopic, RawMessage, RosType, TopicReport

__all__ = ["ObservationStream", "OwnTopic", "RawMessage", "Report", "RosType", "TopicReport"]
