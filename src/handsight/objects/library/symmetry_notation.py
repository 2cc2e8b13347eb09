"""Symmetries said in words: `z` for any turn about z, `z/2` for half turns, `find` for what the shape suggests."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects.model import ObjectModel
from handsight.objects.surface import Triangles
from handsight.objects.symmetry import SYMMETRY_LIMITS, Symmetries, about
from handsight.objects.symmetry_search import propose_symmetries

WORDS = "find, an axis (z: any turn about it), or an axis and a number (z/4: quarter turns)"


class NotationOptions(NamedTuple):
    """`NotationOptions` say when a declared symmetry is refused."""

    tolerance: float = 0.04
    """Of the diameter: a shape that a turn takes this far off itself, but for a fiftieth of it, has not that symmetry.
    """
    samples: int = 1000  # surface points that are compared
    percentile: int = 98  # of the samples' distances that is compared


NOTATION = NotationOptions()


def declared(model: ObjectModel, words: Sequence[str]) -> Symmetries:
    """Returns the symmetries that words say of a model, about the middle of its surface.

    Raises InvalidInput for other words and for turns that take the surface elsewhere.
    """
    if "find" in words:
        if len(words) > 1:
            raise InvalidInput(f"symmetry: expected find alone, got {' '.join(words)}")
        return propose_symmetries(model)
    center, axes, turns = _center(model), [], list[Array]()
    for word in words:
        found = re.fullmatch(r"([xyz])(?:/([1-9]\d{0,2}))?", word)
        if found is None or int(found[2] or 1) > SYMMETRY_LIMITS.max_rotations:
            raise InvalidInput(f"symmetry: expected {WORDS}, got {word!r}")
        axis = np.eye(3)["xyz".index(found[1])]
        angles = [2 * np.pi / int(found[2])] if found[2] else 2 * np.pi * np.arange(1, 12) / 12
        off = max(_off(model, about(center, angle * axis)) for angle in angles)
        if off > NOTATION.tolerance * model.diameter:
            raise InvalidInput(
                f"symmetry: expected turns that leave the surface in place, got {word}, which is {1e3 * off:.1f} mm off"
            )
        if found[2]:
            turns.append(about(center, angles[0] * axis))
        else:
            axes.append((center, axis))
    return Symmetries(axes, np.array(turns) if turns else None)


def _center(model: ObjectModel) -> Array:
    """Returns the middle of the surface (3,) [m], which every symmetry leaves in place."""
    surface = model.surface
    places = surface.corners.mean(axis=1) if isinstance(surface, Triangles) else surface.vertices
    return np.asarray(np.average(places, axis=0, weights=surface.areas))


def _off(model: ObjectModel, T: Array) -> float:
    """Returns how far a turn takes nearly all of the surface off itself, at most [m]."""
    moved = se3.apply(T, model.sample(NOTATION.samples)[0])
    return float(np.percentile(np.abs(model.fine.evaluate(moved).distance), NOTATION.percentile))
