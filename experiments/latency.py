"""How long one correction takes from a near start, default settings: five contacts, vision off by 20 mm and 15 degrees.

One process; the problems of can and box are taken in turn, each once (synthetic). The median says what a
control loop sees; the slow tail are problems whose contacts do not fit at first and are searched for a wrong one.
"""

import numpy as np

import handsight as hs
import report
import scenes
from convergence import ERRORS, NOISE, OBJECTS


def main():
    """Runs the experiment."""
    options, _ = report.parsed(report.parser(__doc__), trials=400, quick_trials=40)
    rows = []
    models = {name: (make(), draw) for name, (make, draw) in OBJECTS.items()}
    for k in report.progress(range(options.trials), "correcting"):
        for o, (name, (model, draw)) in enumerate(models.items()):
            rng = options.rng(o, k)
            scene = scenes.grasp(*draw(rng), rng, noise=NOISE, error=ERRORS["20 mm / 15°"])
            _, seconds = report.timed(
                lambda m=model, s=scene: hs.correct_pose(m, s.contacts, vision=s.vision)
            )
            rows.append({"object": name, "trial": k, "ms": 1e3 * seconds})
    table = []
    for name in models:
        ms = [row["ms"] for row in rows if row["object"] == name]
        table.append([name, *(f"{np.quantile(ms, q):.1f}" for q in (0.05, 0.5, 0.9, 0.99))])
    report.print_table(
        f"One correction in ms, {options.trials} each (synthetic)",
        ["object", "5 %", "median", "90 %", "99 %"],
        table,
        report.machine(),
    )
    report.write_csv(options.output / "latency.csv", rows)


if __name__ == "__main__":
    main()
