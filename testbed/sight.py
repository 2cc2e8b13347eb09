"""Drawn pictures of ten YCB objects, one of which is to be found.

A bin states where the object is: on a table with two others close to it; the same with a Shadow hand that hides 20 to
50 % of it; or anywhere in front of the camera, with the hand hiding a share of it.
"""

import functools
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import handsight as hs
from handsight.objects import ObjectWarning, propose_symmetries
from testbed import sight_scenes as scenes
from testbed import ycb

FITTED_ON = (100, 101)
"""Seeds of the pictures that constants were fitted to."""
LOOKS_ALIKE = 0.02
"""Error of a symmetry, relative to the diameter, that depth images do not show."""


class Bin(NamedTuple):
    """Where an object is, and the share of its silhouette that is hidden."""

    table: bool
    hand: bool
    hidden: tuple[float, float]


BINS = {
    "table": Bin(True, False, (0.0, 1.0)),
    "table, hand 20-50 %": Bin(True, True, (0.2, 0.5)),
    **{f"hand {a}-{a + 20} %": Bin(False, True, (a / 100, a / 100 + 0.2)) for a in (0, 20, 40, 60)},
}


@functools.cache
def objects() -> dict[str, hs.ObjectModel]:
    """Returns the ten objects by name, each with the symmetries that a depth camera cannot tell apart."""
    found = {}
    for path in sorted((ycb.data_or_goodbye() / "ycb_meshes").glob("*.ply")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ObjectWarning)  # the marker's mesh has triangles without area
            model = hs.ObjectModel.from_file(path)
        found[path.stem] = model.with_symmetries(propose_symmetries(model, LOOKS_ALIKE * model.diameter))
    return found


def picture(name: str, k: int, seed: int) -> tuple[str, scenes.Picture]:
    """Returns the name of the object, which are taken in turn, and the k-th picture of a bin."""
    models, kind = objects(), BINS[name]
    rng = np.random.default_rng([seed, list(BINS).index(name), k])
    chosen = list(models)[k % len(models)]
    if not kind.table:
        return chosen, scenes.in_hand(models[chosen], scenes.shadow_hand(), rng, kind.hidden)
    others = rng.choice([other for other in models if other != chosen], 2, replace=False)
    shapes = [models[chosen], *(models[other] for other in others)]
    hand = scenes.shadow_hand() if kind.hand else None
    return chosen, scenes.tabletop(shapes, rng, kind.hidden, hand=hand)


def tasks(trials: int, seeds: Sequence[int]) -> list[tuple[str, int, int]]:
    """Returns the arguments of `picture` for `trials` pictures of each bin and seed."""
    return [(name, k, seed) for seed in seeds for name in BINS for k in range(trials)]
