"""Fits what the probability of a first pose weighs: `EVIDENCE` of `handsight.vision.object.first_pose`.

Objects are looked for in real depth images (`testbed/real_frames.py`) and in drawn ones (`testbed/sight.py`, seed 100).
One that is there is searched anywhere, in its box and (real) in its mask; one that is not, anywhere or in the box of
another. The weights maximise the likelihood of what is true of each search: which of the places that its poses have is
right (ADD-S below 10 % of the diameter), or that none is. Each real scene and each bin of drawn pictures has the same
weight, and as much of it has searches for what is there as for what is not.

Real scenes judge weights that were fitted without them, to the other real scenes and all drawn pictures; drawn pictures
those that were fitted to real scenes and to the pictures of the other half of the objects.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

import handsight as hs
from handsight.vision.object.first_pose import evidence_of, first_pose, places_of
from handsight.vision.object.locate import LOCATE
from handsight.vision.object.region import Scene, scene_of
from shared import report, sight, ycb
from shared import sight_scenes as scenes
from testbed import real_frames
from testbed.real_frames import TOLD, RealFrame
from testbed.report import Array

RIGHT = 0.1
"""The largest ADD-S of a right pose [diameters]."""
ANYWHERE, BOX, MASK = TOLD
DRAWN_SHARE = 0.375
"""Weight of a bin of drawn pictures against a real scene's: all bins together count about as much as three scenes."""
ABSENT = 2.0
"""Weight of a drawn search for an object that is not there against one that is: what nobody has asked to be claimed
is worse than what is not answered."""
PENALTY = 4e-4
"""On the sum of the squared weights, against the mean log likelihood of a search."""
LEVELS = (0.1, 0.2, 0.3, 0.4, LOCATE.min_probability)
EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
"""Of probabilities that are compared with how often the place is right."""


class Search(NamedTuple):
    """A `Search` has the poses that were found of one object in one image."""

    real: bool
    group: str
    """The real scene, or the bin of drawn pictures."""
    name: str
    told: str
    there: bool
    evidence: Array
    """(k, 5)"""
    places: Array
    """(k,) numbers of the poses' places."""
    right: Array
    """(k,)"""


def searched(
    scene: Scene,
    model: hs.ObjectModel,
    what: tuple[bool, str, str, str],
    right: Callable[[Array], Array] | None,
) -> Search:
    """Returns what is found of an object; right: which of poses (k, 4, 4) are; None: it is not there."""
    found = first_pose(model, scene)
    Ts, none = found.Ts_camera_object, np.zeros(len(found.weights), dtype=bool)
    true = none if right is None or not len(none) else right(Ts)
    return Search(
        *what, right is not None, evidence_of(found.candidates), places_of(model, found.candidates), true
    )


def in_real(k: int, most: int) -> list[Search]:
    """Returns all searches in the k-th of the real images, of which at most so many of a scene are taken."""
    data = real_frames.open_folder(real_frames.default_folder())
    frame: RealFrame = data.some(most)[k]()
    found = []
    for j, (name, model) in enumerate(data.models.items()):
        truths = [one for one in frame.instances if one.name == name]
        extent = LOCATE.max_plane * model.diameter

        def right(Ts: Array, model: Any = model, truths: Any = truths) -> Array:
            errors = [[real_frames.add_s(model, one.T_camera_object, T) for one in truths] for T in Ts]
            return np.asarray(np.min(errors, axis=1) < RIGHT)

        of = truths[0] if truths else frame.instances[(k + j) % len(frame.instances)]
        for told in TOLD if truths else (ANYWHERE, BOX):
            scene = scene_of(frame.camera, frame.depth, wanted=frame.wanted(of, told), extent=extent)
            what = True, frame.scene, name, told
            found.append(searched(scene, model, what, right if truths else None))
    return found


def in_drawn(name: str, k: int, seed: int) -> list[Search]:
    """Returns the searches in one drawn picture: for its object, and where no other is there for three that are not."""
    of, picture = sight.picture(name, k, seed)
    rng, found, others = np.random.default_rng([seed, k, 5]), list[Search](), list[str]()
    if not picture.on_table:
        others = list(rng.choice([one for one in sight.objects() if one != of], 3, replace=False))
    for each in (of, *others):
        model = sight.objects()[each]

        def right(Ts: Array) -> Array:
            return scenes.adds(picture.model, picture.T_camera_object, Ts) < RIGHT

        for told in (BOX, ANYWHERE) if picture.on_table else (BOX,):
            extent, wanted = LOCATE.max_plane * model.diameter, picture.wanted if told == BOX else None
            scene = scene_of(scenes.WIDE, picture.depth, wanted=wanted, hand=picture.hand, extent=extent)
            found.append(searched(scene, model, (False, name, each, told), right if each == of else None))
    return found


def of_places(weights: Array, one: Search) -> tuple[Array, Array]:
    """Returns the probabilities of a search's places, of which the last is nowhere, and whether each is right."""
    count = one.places.max(initial=-1) + 1
    odds, right = np.full(count + 1, -np.inf), np.zeros(count + 1, dtype=bool)
    each = one.evidence @ weights
    np.maximum.at(odds, one.places, each)
    right[one.places[(each == odds[one.places]) & one.right]] = True
    odds[-1], right[-1] = 0.0, not one.right.any()
    p = np.exp(odds - odds.max())
    return p / p.sum(), right


def fitted(searches: list[Search]) -> Array:
    """Returns the weights (5,) of the largest likelihood, less a penalty on large ones: few scenes cannot tell
    whether touching neighbours, say, never look like a surface that goes on."""
    counts = Counter((one.group, one.there) for one in searches)
    groups = [1 if one.real else DRAWN_SHARE * (1 if one.there else ABSENT) for one in searches]
    shares = np.array([w / counts[one.group, one.there] for w, one in zip(groups, searches, strict=True)])

    def loss(weights: Array) -> float:
        likelihoods = [p[right].sum() for p, right in (of_places(weights, one) for one in searches)]
        mean = float((shares * np.log(np.maximum(likelihoods, 1e-9))).sum() / shares.sum())
        return PENALTY * float(weights @ weights) - mean

    options = {"maxiter": 1000, "xatol": 0.01, "fatol": 1e-5}
    return np.asarray(minimize(loss, [-5.0, 9.0, -3.0, -5.0, -7.0], method="Nelder-Mead", options=options).x)


def judged(
    searches: list[Search], left_out: Sequence[Callable[[Search], bool]]
) -> list[tuple[Search, float, bool]]:
    """Returns each search that is left out once, with the probability of its best place, and whether that is right."""
    answers = []
    for chosen in left_out:
        weights = fitted([one for one in searches if not chosen(one)])
        for one in filter(chosen, searches):
            p, right = of_places(weights, one)
            best = int(p[:-1].argmax()) if len(p) > 1 else -1
            against = float(p[best] / (p[best] + p[-1]))  # nowhere, whatever other places there are
            answers.append((one, against if best >= 0 else 0.0, best >= 0 and bool(right[best])))
    return answers


def of_scene(scene: str, one: Search) -> bool:
    """Returns whether a search is in a real scene."""
    return one.real and one.group == scene


def of_names(names: list[str], one: Search) -> bool:
    """Returns whether a search in a drawn picture is for one of some objects."""
    return not one.real and one.name in names


def show(title: str, answers: list[tuple[Search, float, bool]]) -> None:
    """Prints what is answered above each level, and how often the best place is right, by its probability."""
    cells = []
    for level in LEVELS:
        row = [f"{level:g}"]
        for told in TOLD:
            there = [(p >= level, right) for one, p, right in answers if one.told == told and one.there]
            absent = [p >= level for one, p, _ in answers if one.told == told and not one.there]
            row.append(f"{np.mean([a and b for a, b in there]):.2f}" if there else "")
            row.append(f"{np.mean([a and not b for a, b in there]):.3f}" if there else "")
            row.append(f"{np.mean(absent):.3f}" if absent else "")
        cells.append(row)
    columns = ("probability", *(f"{told}: {what}" for told in TOLD for what in ("right", "wrong", "absent")))
    report.print_table(title, columns, cells, "Shares of the searches that are answered with at least that.")
    cells = []
    p, right = np.array([p for _, p, _ in answers]), np.array([right for *_, right in answers])
    for low, high in pairwise(EDGES):
        among = (p > low) & (p <= high)
        if among.any():
            cells.append([f"{p[among].mean():.2f}", f"{right[among].mean():.2f}", f"{among.sum()}"])
    report.print_table(f"{title}: reliability", ("mean probability", "right", "searches"), cells)


@report.or_skip
def main() -> None:
    """Runs the fit."""
    options = report.options(__doc__, trials=20, quick_trials=1)
    frames = real_frames.open_folder(real_frames.default_folder())
    tasks = [(k, options.trials) for k in range(len(frames.some(options.trials)))]
    real = [one for some in ycb.in_parallel(in_real, tasks, "real images") for one in some]
    drawn_tasks = sight.tasks(options.trials, sight.FITTED_ON[:1])
    drawn = [one for some in ycb.in_parallel(in_drawn, drawn_tasks, "drawn images") for one in some]
    searches, names = real + drawn, sorted({one.name for one in drawn})
    weights = ", ".join(f"{x:.2f}" for x in fitted(searches))
    report.say(
        f"EVIDENCE = {weights} from {len(real)} searches in real images and {len(drawn)} in drawn ones"
    )
    by_scene = [partial(of_scene, scene) for scene in frames.scenes]
    show("Real, each scene by the others' weights", judged(searches, by_scene))
    halves = [partial(of_names, names[half::2]) for half in range(2)]
    show("Drawn, each half of the objects by the other's", judged(searches, halves))


if __name__ == "__main__":
    main()
