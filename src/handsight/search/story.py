"""A search by touch in words: what a touch met, what is known of the pose, and what is still open."""

import numpy as np

from handsight.correction.modes import pose_distances
from handsight.objects import ObjectModel
from handsight.search.belief import CERTAINTY, Belief

MIN_PROBABILITY = 0.05  # less likely modes are not named


def touch_text(belief: Belief) -> str:
    """Returns a line about the last touch, and about what is known after it."""
    touch, best = belief.touches[-1], belief.modes[0]
    outcome = "met nothing"
    if touch.contact_world is not None:
        place = ", ".join(f"{1e3 * x:.0f}" for x in touch.contact_world.points_palm[0] + 0.0)
        outcome = f"contact at [{place}] mm"
    likely = sum(mode.probability >= MIN_PROBABILITY for mode in belief.modes)
    others = f", the likeliest of {likely} hypotheses {best.probability:.2f}" if likely > 1 else ""
    yaw = np.rad2deg(best.sigma_yaw)
    known = f"position ± {1e3 * best.sigma_position:.1f} mm" + (f", yaw ± {yaw:.0f}°" if yaw > 0.5 else "")
    return f"touch {len(belief.touches)}: {outcome}; {known}{others}; certain to {best.certainty:.2f}"


def open_text(belief: Belief) -> str:
    """Returns in a sentence what is known of the object's pose, and what is still open."""
    best, *others = belief.modes
    others = [mode for mode in others if mode.probability >= MIN_PROBABILITY]
    parts = [f"the position is known to {1e3 * best.sigma_position:.0f} mm"]
    if best.sigma_position > CERTAINTY.position / 2:
        parts = [f"the position is open (± {1e3 * best.sigma_position:.0f} mm)"]
    if best.sigma_yaw > CERTAINTY.rotation / 2:
        parts.append(f"the spin about the vertical is open (± {np.rad2deg(best.sigma_yaw):.0f}°)")
    for mode in others:
        T, T_best = mode.pose_world_object.T_a_b, best.pose_world_object.T_a_b
        shift, turn = (float(x[0]) for x in pose_distances(belief.model, T[None], T_best))
        where = f"{1e3 * shift:.0f} mm away, turned by {np.rad2deg(turn):.0f}°"
        parts.append(f"it may be {where} (probability {mode.probability:.2f})")
    if text := symmetry_text(belief.model):
        parts.append(text)
    return "; ".join(parts)


def symmetry_text(model: ObjectModel) -> str:
    """Returns in words which turns of the object touch cannot tell from each other; empty for none."""
    symmetries, same = model.symmetries, len(model.symmetries.rotations)
    if symmetries.round:
        return "touch cannot tell any turn about its middle"
    if symmetries.axes:
        ends = " nor one end from the other" if same > 1 else ""
        return f"touch cannot tell its spin about its axis{ends}"
    return "" if same == 1 else f"touch cannot tell {same} of its rotations from each other"
