"""Forces: weight, centre of mass and slip of the object in the hand, from the loads on the fingertips."""

from handsight.forces.object_motion import slip_twist
from handsight.forces.slip import Slip, SlipDetector
from handsight.forces.weigher import ObjectWeight, Weigher, WeightSensor
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh

__all__ = [
    "Carried",
    "ObjectWeight",
    "Slip",
    "SlipDetector",
    "Unknowns",
    "Weigher",
    "Weighing",
    "WeightSensor",
    "slip_twist",
    "weigh",
]
