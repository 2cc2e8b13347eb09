"""Objects: what a hand can hold, as samples of the surface, distance fields and symmetries."""

from handsight.objects.fields import Field, FieldValues
from handsight.objects.library import Facts, Library
from handsight.objects.model import ObjectModel
from handsight.objects.spec import ObjectSpec
from handsight.objects.surface import ObjectWarning
from handsight.objects.symmetry import Symmetries
from handsight.objects.symmetry_search import declared_symmetries, propose_symmetries

__all__ = [
    "Facts",
    "Field",
    "FieldValues",
    "Library",
    "ObjectModel",
    "ObjectSpec",
    "ObjectWarning",
    "Symmetries",
    "declared_symmetries",
    "propose_symmetries",
]
