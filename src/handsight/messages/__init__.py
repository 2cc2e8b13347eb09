"""Conversion of a robot's ROS messages to `Observation`s, the same for a recording as for a live robot.

`ObservationStream` takes one `RawMessage` (topic, type, encoding, log time, bytes) after the other and returns the
observations that each one completes. It guarantees:

* **Time** is `header.stamp` [s], which is trusted. The clock of the joint states is the clock of the rig. A message
  without a stamp is as long after the last joint states as it was logged after them.
* **Clocks**: a topic whose stamps are more than 0.1 s off the joint states' clock is told, by log time minus stamp; the
  rig's `topics.offsets` adds to the stamps of a topic.
* **Order**: messages are sorted by stamp in a window of 0.2 s, widened by how late a camera was until then, at most
  2 s. Messages that come later than that are left out and counted as late. Joint states whose stamp is more
  than 1 s from the last one wait for the next ones: if those agree, both are used; else the first are rejected. Where
  they went back so, the clock was set back, or a recording is played in a loop: all earlier messages are forgotten, and
  the order begins again. Others that are more than 1 s ahead wait for the next joint states too, and are left out if
  they still are.
* **Observations**: each joint state message gives one, at its stamp; several messages with the same stamp give one
  together. It has the positions from all publishers of joint states (at most 0.1 s old), the newest wrench of each
  finger and the newest readings of each tactile array (at most 0.05 s old), `T_world_palm` from /tf (each transform
  static or at most 0.1 s old), and the newest vision pose and images since the last observation (at most 0.2 s old).
* **Left out and counted** are: repeated messages of the same topic and stamp; messages with NaN or infinity; messages
  that cannot be read as the topic's type, in an unknown frame or in a wrong unit; and readings of a sensor that is
  stuck (the same six numbers for 0.5 s while another finger's change) or at full scale.

Every message on a topic of the rig is in exactly one count of `report.topics[name]`.
"""

from handsight.messages.pair import ObservationStream
from handsight.messages.report import Report, TopicReport
from handsight.messages.topics import OwnTopic, RawMessage, RosType

__all__ = ["ObservationStream", "OwnTopic", "RawMessage", "Report", "RosType", "TopicReport"]
