"""Simulation: a hand grasps and moves an object whose true pose is known, with chosen errors of its sensors."""

from handsight._deprecated import renamed
from handsight.simulation.camera import add_depth_noise, camera_facing, render, true_camera
from handsight.simulation.grasp_file import read_grasp, write_grasp
from handsight.simulation.grasp_search import GraspSearchResult, find_grasp
from handsight.simulation.motion import MOTION, Grasp
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import SCENARIO, Nuisances, Profile, Sample, Scenario, TipContact
from handsight.simulation.simulate import ConstantErrors, constant_errors, simulate, simulate_each
from handsight.simulation.touch_search import (
    PROBE,
    TOUCH_SEARCH,
    Probe,
    simulate_touch_search,
    start_search,
    touch_search_rig,
)

__all__ = [
    "MOTION", "PROBE", "SCENARIO", "TOUCH_SEARCH", "ConstantErrors", "Grasp", "GraspSearchResult", "Nuisances", "Probe",
    "Profile", "Sample", "Scenario", "TipContact", "add_depth_noise", "camera_facing", "constant_errors", "find_grasp",
    "model_of", "read_grasp", "render", "rig_of", "simulate", "simulate_each", "simulate_touch_search", "start_search",
    "touch_search_rig", "true_camera", "write_grasp",
]  # fmt: skip

__getattr__ = renamed(__name__, {
    "Found": "handsight.simulation.GraspSearchResult",
    "blind_rig": "handsight.simulation.touch_search_rig",
    "looking": "handsight.simulation.camera_facing",
    "simulate_blind": "handsight.simulation.simulate_touch_search",
})  # fmt: skip
