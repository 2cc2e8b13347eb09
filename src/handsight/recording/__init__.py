"""Recordings: MCAP, rosbag 1 and rosbag 2 read as `Observation`s and written as MCAP; tracks written as MCAP, TUM, CSV.

`handsight.messages` describes how messages become observations, for a recording as for a running robot. Everything
readable of a damaged file is read; `report.truncated` and `report.sentences()` say what was lost.
"""

from handsight.recording.bop import BopResult, read_bop_results
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
