"""Forces: what the loads on the fingertips tell of a held object: its weight, its centre of mass, whether it slips."""

from handsight.forces.slip import Slip, SlipDetector
from handsight.forces.slip_motion import slip_twist
from handsight.forces.weigher import Weigher
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh

__all__ = ["Carried", "Slip", "SlipDetector", "Unknowns", "Weigher", "Weighing", "slip_twist", "weigh"]
