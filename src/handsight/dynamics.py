"""Deprecated: this room is now `handsight.forces`."""

from handsight._deprecated import renamed

_NAMES = ("Carried", "Slip", "SlipDetector", "Unknowns", "Weigher", "Weighing", "slip_twist", "weigh")
__getattr__ = renamed(__name__, {name: f"handsight.forces.{name}" for name in _NAMES})
