"""Forces: weight, centre of mass and slip of the object in the hand, from the loads on the fingertips."""

from handsight.forces.kernels.slip_records import FRICTION, SLIP
from handsight.forces.loads import (
    LINK_TAXELS,
    LoadSensor,
    LoadSum,
    calibrate_sensors,
    load_sensors,
    load_sum,
    read_in_air,
)
from handsight.forces.object_motion import moved_with_tips, slip_twist
from handsight.forces.slip import Slip, SlipDetector
from handsight.forces.weigher import ObjectWeight, Weigher, WeightSensor
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh

__all__ = [
    "FRICTION", "LINK_TAXELS", "SLIP", "Carried", "LoadSensor", "LoadSum", "ObjectWeight", "Slip",
    "SlipDetector", "Unknowns", "Weigher", "Weighing", "WeightSensor", "calibrate_sensors",
    "load_sensors", "load_sum", "moved_with_tips", "read_in_air", "slip_twist", "weigh",
]  # fmt: skip
