"""Objects: what a hand can hold, as samples of the surface, distance fields and symmetries."""

from handsight.objects.build import ObjectWarning
from handsight.objects.field import Field, FieldValues
from handsight.objects.model import ObjectModel
from handsight.objects.propose import propose_symmetries
from handsight.objects.symmetry import Symmetries

__all__ = ["Field", "FieldValues", "ObjectModel", "ObjectWarning", "Symmetries", "propose_symmetries"]
