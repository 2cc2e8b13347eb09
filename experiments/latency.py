"""How long one correction takes from a near start, default settings: five contacts, vision off by 20 mm and 15 degrees.

One process; the problems of can and box are taken in turn, each once (synthetic). The median says what a
control loop sees; the slow tail are problems whose contacts do not fit at first and are searched for a wrong one.
"""

from functools import partial

import numpy as np

import handsight as hs
from shared import report, scenes


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=400, quick_trials=40)
    rows = []
    for k in report.progress(range(options.trials), "correcting"):
        for o, (name, (make, draw)) in enumerate(scenes.OBJECTS.items()):
            rng = options.rng(o, k)
            scene = scenes.random_scene(draw(rng), rng)
            _, seconds = report.timed(partial(hs.correct_pose, make(), scene.contacts, vision=scene.vision))
            rows.append({"object": name, "trial": k, "ms": 1e3 * seconds})
    table = []
    for name in scenes.OBJECTS:
        ms = report.values(rows, "ms", object=name)
        table.append([name, *(f"{np.quantile(ms, q):.1f}" for q in (0.05, 0.5, 0.9, 0.99))])
    title = f"One correction in ms, {options.trials} each (synthetic)"
    report.print_table(title, ["object", "5 %", "median", "90 %", "99 %"], table, report.machine())
    report.write_csv(options.output / "latency.csv", rows)


if __name__ == "__main__":
    main()
