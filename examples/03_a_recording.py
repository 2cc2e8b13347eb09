"""A recording is read with its rig, checked for missing data and tracked; the track is written as TUM text and MCAP."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import _picture
import handsight as hs
from handsight.recording import RecordingWriter, TrackRow, open_recording, write_track_mcap, write_track_tum
from handsight.rig.save import write as write_rig
from handsight.simulation import Scenario, rig_of, simulate

temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)

# A robot would have recorded this; here a simulated hand closes on a can. The truth has its own topic.
scenario = Scenario(object="can", motion="grasp", rate=50, seed=1)
write_rig(rig_of(scenario), folder / "rig.yaml")
with RecordingWriter(folder / "can.mcap", rig_of(scenario)) as writer:
    for sample in simulate(scenario):
        writer.write(sample.observation)
        writer.write_truth(sample.observation.stamp, sample.T_palm_object)

# From here on your own recording works the same: .mcap, .bag, .db3 or the folder of a rosbag 2.
rig = hs.Rig.from_file(folder / "rig.yaml")
model = replace(rig.objects["can"].model(), name="can")
tracker = hs.Tracker(rig, model)
rows = []
with open_recording(folder / "can.mcap", rig) as recording:
    for observation in recording.observations():
        estimate = tracker.update(observation)
        if estimate is not None:
            pose = estimate.T_palm_object, estimate.covariance
            rows.append(TrackRow(observation.stamp, *pose, tracker.state, tracker.reason))
    # Faults that were counted while reading, and data that the recording lacks; none where all is well.
    for sentence in [*recording.report.sentences(), *recording.lacks()]:
        print("-", sentence)
    observations, truth = recording.report.observations, recording.truth

write_track_tum(folder / "can.tum", rows)
write_track_mcap(folder / "can-track.mcap", rows, frame=rig.frames["palm"])
print(f"{observations} observations, {len(rows)} poses, {tracker.corrections} corrections")
print(f"at the end: {tracker.state}, sigma {1e3 * tracker.sigma:.1f} mm")

stamps = np.array([row.stamp for row in rows])
nearest = np.abs(stamps[:, None] - [stamp for stamp, _ in truth]).argmin(axis=1)
positions = np.array([row.T_palm_object[:3, 3] for row in rows])
errors = 1e3 * np.linalg.norm(positions - np.array([truth[k][1][:3, 3] for k in nearest]), axis=1)
print(f"error of the position [mm]: {errors[0]:.1f} at first, {errors[-1]:.1f} at the end")
_picture.over_time("A recording, tracked", stamps - stamps[0], {"error of the position": errors})
temporary.cleanup()
