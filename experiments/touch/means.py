"""The default's mean and covariance of a slide against those of many posterior samples, and what they cost.

Grips of `shared.grips`: boxes of random sides and cans of random sizes, two fingers and a thumb on opposite sides;
*table*: height known to 3 mm; *plane*: a table that the object cannot cross; *beside*: 40 points of a hand beside it.
Problems whose answer is the maximum (a Gaussian mode), or that has more than one hypothesis, are left out and counted.

  mean       how far the mean is off that of the samples, along its worst direction, in deviations; maximum: as far
  deviations the default's, as a share of the samples', over all directions: from the 5th to the 95th percentile
  ms         of a correction, least of ten; samples: of the reference
"""

from functools import partial
from typing import Any

import numpy as np

import handsight as hs
from experiments.shared.grips import IN_SPACE, ON_TABLE, gripped
from handsight import se3
from handsight.correction import Outside, Plane
from testbed import report, scenes
from testbed.report import Array, Row, Rows
from testbed.sampled import sampled

SAMPLES, QUICK_SAMPLES = 100_000, 20_000
REPEATS = 10
"""Of what is timed, in turn; the least counts."""
KINDS = ("box", "box, table", "box, plane", "box, beside", "can", "can, table")


def deviations(rows: Rows) -> str:
    """The cell of the range of ratios of deviations."""
    low, high = np.quantile(np.concatenate([row["ratios"] for row in rows]), [0.05, 0.95])
    return f"{low:.2f}-{high:.2f}"


CELLS = {
    "slides": report.count,
    "mean": report.of("mean", ".2f", np.median),
    "90 %": report.of("mean", ".2f", report.quantile(0.9)),
    "maximum": report.of("maximum", ".2f", np.median),
    "deviations": deviations,
    "ms": report.of("ms", ".1f", np.median),
    "ms samples": report.of("ms samples", ".0f", np.median),
}
SPIN = 1e-6
"""Information this much below the largest is that of a spin about a can's axis: none."""


def problem(kind: str, rng: np.random.Generator) -> tuple[hs.ObjectModel, hs.Contacts, Row, Array]:
    """Returns the object, its contacts, the other evidence, and the true pose."""
    half = rng.uniform([0.015, 0.02, 0.03], [0.05, 0.05, 0.10])
    flat = kind.startswith("box")
    model = hs.ObjectModel.box(2 * half) if flat else hs.ObjectModel.cylinder(half[1], 2 * half[2])
    points, normals = scenes.opposed(rng, half[1], flat)
    points[:, [0, 2]] = (
        np.clip(points[:, [0, 2]], -0.9 * half[[0, 2]], 0.9 * half[[0, 2]]) if flat else points[:, [0, 2]]
    )
    contacts, vision, T = gripped((points, normals), rng, ON_TABLE if "table" in kind else IN_SPACE)
    known: Row = {"vision": vision}
    if "plane" in kind:
        foot = se3.apply(T, np.array([[0.0, 0, -half[2]]]))[0]
        known["outside"] = Outside(planes=[Plane(foot, T[:3, 2], 3e-3)])
    if "beside" in kind:
        aside = np.column_stack([np.full(40, -half[0] - 0.004), *rng.uniform(-0.05, 0.05, (2, 40))])
        known["outside"] = se3.apply(T, aside)
    return model, contacts, known, T


def off_by(
    model: hs.ObjectModel, estimate: hs.PoseEstimate, reference: hs.PoseEstimate
) -> tuple[float, Array]:
    """Returns a mean's distance from a reference in its standard deviations, and the ratios of standard deviations."""
    scale = np.repeat([1.0, model.radius], 3)
    theirs, ours = (e.information / np.outer(scale, scale) for e in (reference, estimate))
    values, vectors = np.linalg.eigh(theirs)
    values, vectors = values[values > SPIN * values[-1]], vectors[:, values > SPIN * values[-1]]
    delta = scale * se3.difference(estimate.T_palm_object, reference.T_palm_object)
    covariance = np.linalg.pinv(ours, rcond=SPIN, hermitian=True)
    ratios = np.sqrt(np.einsum("ia,ij,ja,a->a", vectors, covariance, vectors, values))
    return float(np.abs(vectors.T @ delta * np.sqrt(values)).max()), ratios


def trial(kind: str, rng: np.random.Generator, samples: int) -> Row | None:
    """Returns the rows of one problem; None where no slide is unobservable, or there are several hypotheses."""
    model, contacts, known, _ = problem(kind, rng)
    ask = partial(hs.correct_pose, model, contacts, **known)
    best, seconds = report.timed(ask)
    for _ in range(REPEATS):
        seconds = min(seconds, report.timed(ask)[1])
    maximum = scenes.at_maximum(best)
    if np.array_equal(best.T_palm_object, maximum.T_palm_object) or best.hypotheses[0].weight < 0.99:
        return None
    reference, slow = report.timed(partial(sampled, model, contacts, samples=samples, **known))
    off, ratios = off_by(model, best, reference)
    row: dict[str, Any] = {
        "grip": kind,
        "mean": off,
        "maximum": off_by(model, maximum, reference)[0],
        "ratios": ratios,
    }
    return row | {"ms": 1e3 * seconds, "ms samples": 1e3 * slow}


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=40, quick_trials=4)
    samples, rows = QUICK_SAMPLES if options.quick else SAMPLES, Rows()
    for o, kind in enumerate(KINDS):
        for k in report.progress(range(options.trials), kind):
            row = trial(kind, options.rng(o, k), samples)
            rows += [row] if row else []
    report.print_by(
        f"Means by integration against {samples} samples, {options.trials} grips each (synthetic)",
        rows,
        "grip",
        CELLS,
        "mean, maximum: off the samples' mean, in its deviations, median. Left out: Gaussian modes, many hypotheses.",
    )
    told = [row | {"ratios": " ".join(f"{ratio:.3f}" for ratio in row["ratios"])} for row in rows]
    report.write_csv(options.output / "means.csv", told)


if __name__ == "__main__":
    main()
