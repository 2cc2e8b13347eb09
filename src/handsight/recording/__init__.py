"""Recordings: MCAP, rosbag 1 and rosbag 2 to `Observation`s and back, and what was tracked as MCAP, TUM or CSV.

`handsight.messages` describes what happens to the messages, which is the same for a recording as for a running robot.
Of a damaged file all is read that can be; `report.truncated` and `report.sentences()` tell what was lost.
"""

from handsight.recording.detections import BopResult, read_bop_results
from handsight.recording.open import Recording, RecordingReport, open_recording
from handsight.recording.write import (
    RecordingWriter,
    TrackRow,
    write_track_csv,
    write_track_mcap,
    write_track_tum,
)

__all__ = [
    "BopResult",
    "Recording",
    "RecordingReport",
    "RecordingWriter",
    "TrackRow",
    "open_recording",
    "read_bop_results",
    "write_track_csv",
    "write_track_mcap",
    "write_track_tum",
]
