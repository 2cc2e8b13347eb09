"""The search for a grasp that holds an object: candidates are tried in the simulator until one does."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import NamedTuple

import numpy as np

from handsight._deprecated import renamed_members
from handsight.errors import InvalidObject, NotFound
from handsight.rig import Rig
from handsight.simulation.grasp_fit import HandFit
from handsight.simulation.motion import BOX, CAN, LEGS, MOTION, POWER_CAN, Grasp
from handsight.simulation.scenario import SCENARIO, Scenario
from handsight.simulation.scene import SimulatedScene, convex_hull, scene
from handsight.simulation.shadow_grasps import Body, Posture, body_of, grasp_candidates
from handsight.simulation.world import World


class GraspSearchOptions(NamedTuple):
    """`GraspSearchOptions` configure the trials of grasps in simulation."""

    max_fitted: int = 90  # candidates to which the hand is fitted before the search gives up
    max_trials: int = 24  # grasps that are simulated


GRASP_SEARCH = GraspSearchOptions()


@renamed_members(held="succeeded")
@dataclass(frozen=True, slots=True, eq=False)
class GraspSearchResult:
    """A `GraspSearchResult` is a grasp of an object, and how it was found."""

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
    body = body_of(convex_hull(scenario.object)[0])
    if scenario.rig is None:
        candidates, opening = _shadow_grasps(built, body), ""
    else:
        fit = HandFit(scenario.rig, built, body, int(scenario.seed))
        candidates, opening = fit.grasps(), f"fingertips open to {1000 * fit.opening:.0f} mm; "
    failures, trials = Counter[str](), 0
    best: tuple[float, Grasp | None, str] = (-1.0, None, "")
    for fitted, (grasp, reason, name) in enumerate(islice(candidates, GRASP_SEARCH.max_fitted)):
        if progress is not None:
            progress(max(fitted / GRASP_SEARCH.max_fitted, trials / GRASP_SEARCH.max_trials))
        if grasp is not None:
            trials += 1
            pressing = "th" if scenario.rig is None else name.partition(" against ")[0]
            lasted, reason = _trial(tried, grasp, pressing)
            if not reason:
                return GraspSearchResult(grasp, True, trials, name, _text(failures))
            best = max(best, (lasted, grasp, name), key=lambda b: b[0])
        failures[reason] += 1
        if trials == GRASP_SEARCH.max_trials:
            break
    if best[1] is None:
        size = " x ".join(f"{1000 * side:.0f}" for side in np.ptp(built.bounds_object, axis=0))
        why = _text(failures) or "no opposite sides that thumb and fingers span"
        message = f"object: expected one that fits in the open hand, got {size} mm ({opening}{why})"
        raise InvalidObject(message) if scenario.rig is None else NotFound(message)
    return GraspSearchResult(best[1], False, trials, best[2], opening + _text(failures))


@lru_cache(maxsize=16)
def grasp_for(name: str, seed: int, *, skin: bool = False, rig: Rig | None = None) -> Grasp:
    """Returns the grasp that `find_grasp` finds for an object and a seed, searched once; raises as `find_grasp`."""
    return find_grasp(Scenario(object=name, seed=seed, skin=skin, rig=rig)).grasp


def _shadow_grasps(built: SimulatedScene, body: Body) -> Iterator[tuple[Grasp | None, str, str]]:
    """Yields the Shadow hand's grasps and their names, and the reason where there is none; see `HandFit.grasps`."""
    left, failed = grasp_candidates(body), Counter[tuple[int, float, float]]()
    while left:  # each that was yielded before has failed, and lowers the merit of those of its `kin`
        hold = max(left, key=lambda each: each.merit - 0.1 * failed[each.kin])
        left.remove(hold)
        failed[hold.kin] += 1
        fingers = ", ".join(finger for finger in hold.points if finger != "th")
        side = ("the side", "obliquely above", "above")[round(hold.roll / (np.pi / 4))]
        yield *Posture(built, hold).grasp(), f"thumb against {fingers}, from {side}"


def _trial(scenario: Scenario, grasp: Grasp, pressing: str) -> tuple[float, str]:
    """Returns how long a grasp holds the object [s], and why no longer; the reason is empty if it holds to the end. The
    finger `pressing` and another must touch the object nearly all the time."""
    try:
        world = World(scenario, grasp)
    except InvalidObject:
        return 0.0, "no room to open"
    # The reason by the time until which the object slips [s].
    slips = (
        (MOTION.moves, "slipped when let go"),
        (MOTION.at_rest + float(LEGS[:4, 0].sum()), "slipped on the table"),
        (MOTION.at_rest + float(LEGS[:5, 0].sum()), "slipped when lifted"),
        (np.inf, "slipped when turned"),
    )
    every, checked, in_contact = round(0.05 * SCENARIO.steps_per_second), 0, 0  # a check every 0.05 s
    while world.time < world.duration:
        world.step()
        if world.steps % every or world.time <= MOTION.free:
            continue
        if world.thrown():
            return 0.0, "thrown by the simulator"
        shift, turn = world.moved()
        if shift > 0.024 or turn > 0.42:  # well below what counts as dropped [m, rad]
            return world.time, next(reason for end, reason in slips if world.time <= end)
        touches = world.touches()
        if max((depth for _, _, depth in touches), default=0.0) > 0.002:  # [m]
            return world.time, "pressed in"
        unsensed = sum(force for geom, force, _ in touches if not geom.endswith("_tip"))
        if unsensed > 2.0:  # [N]
            return world.time, "pressed by links without a sensor"
        tips = {tip for tip, force, _ in touches if force > 0.1 and tip.endswith("_tip")}  # [N]
        checked, in_contact = checked + 1, in_contact + (f"{pressing}_tip" in tips and len(tips) > 1)
    return world.time, "" if in_contact >= 0.9 * checked else "hardly in contact"


def _text(failures: Counter[str]) -> str:
    return ", ".join(f"{reason}: {count}" for reason, count in failures.most_common())
