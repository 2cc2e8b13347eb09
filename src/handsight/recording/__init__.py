"""Recordings: MCAP, rosbag 1 and rosbag 2 read as `Observation`s and written as MCAP; tracks written as MCAP, TUM, CSV.

`handsight.messages` describes how messages become observations, for a recording as for a running robot. A damaged
file is read up to the damage, or refused in a sentence that names the tool to mend it; `report.sentences()` says what
was lost.
"""

from handsight.recording.open import Recording, open_recording
from handsight.recording.pose_file import GivenPose, read_poses
from handsight.recording.write import (
    RecordingWriter,
    TrackRow,
    write_track_csv,
    write_track_mcap,
    write_track_tum,
)

__all__ = [
    "GivenPose",
    "Recording",
    "RecordingWriter",
    "TrackRow",
    "open_recording",
    "read_poses",
    "write_track_csv",
    "write_track_mcap",
    "write_track_tum",
]
