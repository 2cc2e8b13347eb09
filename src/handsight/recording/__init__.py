"""Recordings: MCAP, rosbag 1 and rosbag 2 to `Observation`s and back, and what was tracked as MCAP, TUM or CSV.

What becomes of the messages is said in `handsight.messages`: a recording is read as a live robot is heard. A damaged
file gives what can be read of it; `report.truncated` and `report.sentences()` say what was lost.
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
