"""Truth: a simulated hand that grasps and moves an object, with known pose and chosen errors."""

from handsight.simulation.camera import camera_facing
from handsight.simulation.grasp_file import read_grasp, write_grasp
from handsight.simulation.grasp_search import GraspSearchResult, find_grasp
from handsight.simulation.motion import Grasp
from handsight.simulation.rendering import render
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import Nuisances, Sample, Scenario, TipContact
from handsight.simulation.simulate import simulate
from handsight.simulation.touch_search import simulate_touch_search, touch_search_rig

__all__ = [
    "Grasp",
    "GraspSearchResult",
    "Nuisances",
    "Sample",
    "Scenario",
    "TipContact",
    "camera_facing",
    "find_grasp",
    "model_of",
    "read_grasp",
    "render",
    "rig_of",
    "simulate",
    "simulate_touch_search",
    "touch_search_rig",
    "write_grasp",
]
