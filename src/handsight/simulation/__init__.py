"""Truth: a simulated hand that grasps and moves an object, with known pose and chosen errors."""

from handsight.simulation.camera import looking
from handsight.simulation.rendering import render
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import Nuisances, Sample, Scenario, TipContact
from handsight.simulation.simulate import simulate

__all__ = [
    "Nuisances",
    "Sample",
    "Scenario",
    "TipContact",
    "looking",
    "model_of",
    "render",
    "rig_of",
    "simulate",
]
