"""The search for a grasp that holds an object: candidates are tried in the simulator until one does."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice

import numpy as np

from handsight.errors import InvalidObject, NotFound
from handsight.rig import Rig
from handsight.simulation.grasp_fit import HandFit
from handsight.simulation.grasped_body import body_of
from handsight.simulation.motion import AT_REST, BOX, CAN, FREE_AT, LEGS, MOVES_AT, POWER_CAN, Grasp
from handsight.simulation.scenario import STEPS_PER_SECOND, Scenario
from handsight.simulation.scene import convex_hull, scene
from handsight.simulation.world import World

MAX_FITTED = 96
"""Candidates to which the hand is fitted before the search gives up."""
MAX_TRIALS = 24
"""Grasps that are simulated."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspSearchResult:
    """A grasp of an object, and how it was found."""

    grasp: Grasp
    succeeded: bool
    """Whether a trial held it through the whole manipulation; else this is the grasp that held it longest."""
    trials: int  # how many grasps were simulated
    hold: str  # which fingers hold it, and from which side the hand comes
    failures: str  # how often each kind of failure occurred; empty where nothing failed


def find_grasp(scenario: Scenario, progress: Callable[[float], None] | None = None) -> GraspSearchResult:
    """Returns a grasp that holds the scenario's object through a manipulation with the scenario's seed and nuisances.

    The same scenario gives the same grasp. `progress` is called with the share of the search that is done, 0 to 1.
    Raises MissingExtra, InvalidFile, or, where the hand cannot get around the object, InvalidObject; for the hand of a
    rig, which is not known to have any grasp, NotFound.
    """
    known = {"can": POWER_CAN} if scenario.skin else {"can": CAN, "box": BOX}
    if scenario.rig is None and scenario.object in known:
        return GraspSearchResult(known[scenario.object], True, 0, "its own grasp", "")
    tried = replace(scenario, motion="manipulate", images=False)
    built = scene(scenario.object, rig=scenario.rig)
    fit = HandFit(built, body_of(convex_hull(scenario.object)[0]), int(scenario.seed))
    failures = Counter[str]()
    trials = 0
    best: tuple[float, Grasp | None, str] = (-1.0, None, "")
    for fitted, (grasp, reason, name) in enumerate(islice(fit.grasps(), MAX_FITTED)):
        if progress is not None:
            progress(max(fitted / MAX_FITTED, trials / MAX_TRIALS))
        if grasp is not None:
            trials += 1
            pressing = name.partition(" against ")[0]
            lasted, reason = _trial(tried, grasp, pressing)
            if not reason:
                return GraspSearchResult(grasp, True, trials, name, _text(failures))
            best = max(best, (lasted, grasp, name), key=lambda b: b[0])
        failures[reason] += 1
        if trials == MAX_TRIALS:
            break
    if best[1] is None:
        size = " x ".join(f"{1000 * side:.0f}" for side in np.ptp(built.bounds_object, axis=0))
        opening = f"fingertips open to {1000 * fit.opening():.0f} mm"
        message = (
            f"object: expected one that fits in the open hand, got {size} mm ({opening}; {_text(failures)})"
        )
        raise InvalidObject(message) if scenario.rig is None else NotFound(message)
    return GraspSearchResult(best[1], False, trials, best[2], _text(failures))


@lru_cache(maxsize=16)
def grasp_for(name: str, seed: int, *, skin: bool = False, rig: Rig | None = None) -> Grasp:
    """Returns the grasp that `find_grasp` finds for an object and a seed, searched once; raises as `find_grasp`."""
    return find_grasp(Scenario(object=name, seed=seed, skin=skin, rig=rig)).grasp


def _trial(scenario: Scenario, grasp: Grasp, pressing: str) -> tuple[float, str]:
    """Returns how long a grasp holds the object [s], and why no longer; the reason is empty if it holds to the end. The
    finger `pressing` and another must touch the object nearly all the time."""
    try:
        world = World(scenario, grasp)
    except InvalidObject:
        return 0.0, "no room to open"
    # The reason by the time until which the object slips [s].
    slips = (
        (MOVES_AT, "slipped when let go"),
        (AT_REST + float(LEGS["manipulate"][:4, 0].sum()), "slipped on the table"),
        (AT_REST + float(LEGS["manipulate"][:5, 0].sum()), "slipped when lifted"),
        (np.inf, "slipped when turned"),
    )
    every = round(0.05 * STEPS_PER_SECOND)
    checked = 0
    in_contact = 0
    while world.time < world.duration:
        world.step()
        if world.steps % every or world.time <= FREE_AT:
            continue
        if world.thrown():
            return 0.0, "thrown by the simulator"
        shift, turn = world.moved()
        if shift > 0.024 or turn > 0.42:  # well below what counts as dropped [m, rad]
            return world.time, next(reason for end, reason in slips if world.time <= end)
        contacts = world.object_contacts()
        if max((contact.depth for contact in contacts), default=0) > 0.002:  # [m]
            return world.time, "pressed in"
        forces = [(contact.finger, np.linalg.norm(contact.force_palm)) for contact in contacts]
        unsensed = sum(force for part, force in forces if not part.endswith("_tip"))
        if unsensed > 2:  # [N]
            return world.time, "pressed by links without a sensor"
        tips = {part for part, force in forces if part.endswith("_tip") and force > 0.1}  # [N]
        checked += 1
        in_contact += f"{pressing}_tip" in tips and len(tips) > 1
    return world.time, "" if in_contact >= 0.9 * checked else "hardly in contact"


def _text(failures: Counter[str]) -> str:
    return ", ".join(f"{reason}: {count}" for reason, count in failures.most_common())
