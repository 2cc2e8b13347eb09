"""Simulated recordings, as `handsight simulate` writes them."""

from dataclasses import replace
from pathlib import Path

from handsight.recording import RecordingWriter
from handsight.rig.save import write as write_rig
from handsight.simulation import Scenario, rig_of, simulate

BEGINS = 1000.0
"""Stamp at which a recording begins [s]."""


def record(scenario: Scenario, path: Path) -> None:
    """Writes a simulated can or box with its truth to an MCAP file, and its rig beside it, to `STEM.rig.yaml`."""
    rig = rig_of(scenario)
    rig = replace(rig, objects={scenario.object: rig.objects[scenario.object]})
    write_rig(rig, path.with_name(f"{path.stem}.rig.yaml"))
    with RecordingWriter(path, rig) as writer:
        for sample in simulate(scenario):
            observation = replace(sample.observation, stamp=BEGINS + sample.observation.stamp)
            writer.write(observation)
            writer.write_truth(observation.stamp, sample.T_palm_object)
