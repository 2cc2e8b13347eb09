"""Fits what recognition weighs, on the development seeds: the numbers of `handsight.vision.object.first_pose`.

Each object is looked for in each picture. The likeliest weights say which it is of, and, with that object left out,
that it is none of the others. The worth of a mode's score is fitted beside it.
`experiments/sight_recognition.py` judges.
"""

import numpy as np
from scipy.optimize import minimize

from handsight.vision.object.first_pose import EVIDENCE, FIRST_POSE, evidence_of, first_pose
from handsight.vision.object.locate import LOCATE
from handsight.vision.object.region import scene_of
from shared import report, sight, ycb
from shared import sight_scenes as scenes
from testbed.report import Array

RIGHT = 0.1
NEVER = -30.0
PENALTY = 1e-2
"""Penalty on the square of a weight: evidence that several weights share is spread among them."""


def looked_for(name: str, k: int, seed: int) -> tuple[str, dict[str, Array], Array, Array]:
    """Returns the object's name, the best candidate of each object, its own modes' scores (m, 2), which are right."""
    of, picture = sight.picture(name, k, seed)
    models = sight.objects()
    extent = LOCATE.max_plane * max(model.diameter for model in models.values())
    wanted, hand = picture.wanted, picture.hand
    scene = scene_of(scenes.WIDE, picture.depth, wanted=wanted, hand=hand, extent=extent)
    found = {each: first_pose(model, scene) for each, model in models.items()}
    right = scenes.mssd(picture.model, picture.T_camera_object, found[of].Ts_camera_object) < RIGHT
    modes = found[of].candidates
    scores = np.stack([modes["score"], modes["close"] ** FIRST_POSE.close_exponent], axis=1)
    return of, {each: one.candidates[:1] for each, one in found.items()}, scores, right


def loss(weights: Array, indices: Array, evidence: Array) -> float:
    """Returns the negative log likelihood, with "none" as one more answer of log odds 0."""
    odds = np.where(evidence[..., 0] > 0, evidence @ weights, NEVER)
    here = np.logaddexp.reduce(np.c_[odds, np.zeros(len(odds))], axis=1)
    true = odds[np.arange(len(odds)), indices]
    others = odds.copy()
    others[np.arange(len(odds)), indices] = NEVER
    without = np.logaddexp.reduce(np.c_[others, np.zeros(len(odds))], axis=1)
    return float((here - true + without).sum() + PENALTY * (weights**2).sum())


def unlikely(worth: Array, modes: list[tuple[Array, Array]]) -> float:
    """Returns the negative log likelihood of the right modes."""
    total = 0.0
    for each, right in modes:
        weights = np.exp(each @ worth - (each @ worth).max())
        total -= np.log(max(weights[right].sum() / weights.sum(), 1e-12))
    return total


@report.or_skip
def main() -> None:
    """Runs the fit."""
    options = report.options(__doc__, trials=20, quick_trials=3)
    ycb.data_or_goodbye()
    tasks = sight.tasks(options.trials, sight.FITTED_ON)
    answers = ycb.in_parallel(looked_for, tasks, "looking for ten objects")
    names = list(sight.objects())
    indices = np.array([names.index(of) for of, *_ in answers])
    evidence = np.zeros((len(answers), len(names), len(EVIDENCE)))
    for k, (_, candidates, *_) in enumerate(answers):
        for j, name in enumerate(names):
            evidence[k, j] = evidence_of(candidates[name])[0] if len(candidates[name]) else 0.0
    best = minimize(loss, np.zeros(len(EVIDENCE)), args=(indices, evidence), method="BFGS").x
    modes = [(worth, right) for *_, worth, right in answers if right.any()]
    worth = minimize(unlikely, np.array([1.5, 15]), args=(modes,), method="Nelder-Mead").x
    told = ", ".join(f"{x:.2f}" for x in best)
    report.say(f"EVIDENCE = {told} from {len(answers)} pictures of seeds {sight.FITTED_ON}")
    report.say(f"WORTH = {worth[0]:.2f}, {worth[1]:.1f}")
    odds = np.where(evidence[..., 0] > 0, evidence @ best, NEVER)
    cells = []
    for name in sight.BINS:
        mine = np.array([task[0] == name for task in tasks])
        cells.append([name, f"{(odds[mine].argmax(axis=1) == indices[mine]).mean():.3f}"])
    report.print_table("Right of ten, on the pictures that it was fitted on", ("hidden", "right"), cells)
    np.savez(options.output / "sight_fit.npz", evidence=evidence, indices=indices)
    report.wrote(options.output / "sight_fit.npz")


if __name__ == "__main__":
    main()
