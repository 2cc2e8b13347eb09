"""Forces: what the loads on the fingertips tell of a held object: its weight, its centre of mass, whether it slips."""

from handsight.dynamics.slip import Slip, SlipDetector
from handsight.dynamics.slip_motion import slip_twist
from handsight.dynamics.weigher import Weigher
from handsight.dynamics.weight import Carried, Unknowns, Weighing, weigh

__all__ = ["Carried", "Slip", "SlipDetector", "Unknowns", "Weigher", "Weighing", "slip_twist", "weigh"]
