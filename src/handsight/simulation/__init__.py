"""Simulation: a hand grasps and moves an object whose true pose is known, with chosen errors of its sensors."""

from handsight.simulation.camera import add_depth_noise, camera_facing, true_camera
from handsight.simulation.grasp_file import read_grasp, write_grasp
from handsight.simulation.grasp_search import GraspSearchResult, find_grasp
from handsight.simulation.motion import Grasp
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import Nuisances, Profile, Sample, Scenario, TipContact
from handsight.simulation.simulate import ConstantErrors, constant_errors, simulate
from handsight.simulation.touch_search import (
    Probe,
    simulate_touch_search,
    start_search,
    touch_search_rig,
)

__all__ = [
    "ConstantErrors", "Grasp", "GraspSearchResult", "Nuisances", "Probe",
    "Profile", "Sample", "Scenario", "TipContact", "add_depth_noise", "camera_facing", "constant_errors", "find_grasp",
    "model_of", "read_grasp", "rig_of", "simulate", "simulate_touch_search", "start_search",
    "touch_search_rig", "true_camera", "write_grasp",
]  # fmt: skip
