"""Deprecated: this room is now `handsight.forces`."""

from handsight import forces
from handsight._deprecated import renamed

__getattr__ = renamed(__name__, {name: f"handsight.forces.{name}" for name in forces.__all__})
