"""Objects: what a hand can hold, as samples of the surface, distance fields and symmetries."""

from handsight.objects.fields import ExactField, Field, FieldError, FieldValues, GridField
from handsight.objects.files import Shape, ply_bytes, read_shape
from handsight.objects.geometry import Geometry
from handsight.objects.library import Entry, Facts, Library
from handsight.objects.model import ObjectModel
from handsight.objects.spec import ObjectSpec, find_model
from handsight.objects.surface import Cloud, ObjectWarning, Triangles, diameter
from handsight.objects.symmetry import Symmetries, about, kept_center, nearest, tangents
from handsight.objects.symmetry_search import declared_symmetries, propose_symmetries

__all__ = [
    "Cloud",
    "Entry",
    "ExactField",
    "Facts",
    "Field",
    "FieldError",
    "FieldValues",
    "Geometry",
    "GridField",
    "Library",
    "ObjectModel",
    "ObjectSpec",
    "ObjectWarning",
    "Shape",
    "Symmetries",
    "Triangles",
    "about",
    "declared_symmetries",
    "diameter",
    "find_model",
    "kept_center",
    "nearest",
    "ply_bytes",
    "propose_symmetries",
    "read_shape",
    "tangents",
]
