"""A recording is read with its rig, checked for missing data and tracked; the track is written as TUM text and MCAP."""

import tempfile
from dataclasses import replace
from pathlib import Path

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

T_true = truth[-1][1]
error = rows[-1].T_palm_object[:3, 3] - T_true[:3, 3]
print("error of the position [mm]:", (1e3 * error).round(1))
temporary.cleanup()
