"""Forces: weight, centre of mass and slip of the object in the hand, from the loads on the fingertips."""

from handsight._kernels.touch.slip_records import FRICTION, SLIP
from handsight.forces.loads import (
    LINK_TAXELS,
    LOADS,
    LoadSensor,
    LoadSum,
    calibrate_sensors,
    load_sensors,
    load_sum,
    read_in_air,
)
from handsight.forces.object_motion import moved_with_tips, slip_twist
from handsight.forces.slip import Slip, SlipDetector
from handsight.forces.weigher import WEIGHER, ObjectWeight, Weigher, WeightSensor
from handsight.forces.weight import Carried, Unknowns, Weighing, common_equations, weigh

__all__ = [
    "FRICTION", "LINK_TAXELS", "LOADS", "SLIP", "WEIGHER", "Carried", "LoadSensor", "LoadSum", "ObjectWeight", "Slip",
    "SlipDetector", "Unknowns", "Weigher", "Weighing", "WeightSensor", "calibrate_sensors", "common_equations",
    "load_sensors", "load_sum", "moved_with_tips", "read_in_air", "slip_twist", "weigh",
]  # fmt: skip
