"""Fig. 7 of the paper: a held can and box, where vision sees them and where touch puts them.

Simulated grasps (MuJoCo), rendered from the robot's own camera's side: the object as it is, as vision sees it (green,
through the fingers), and corrected (pink). Needs EGL or OSMesa; without, it says so and ends.
"""

from experiments.shared.grasp_methods import corrected
from experiments.shared.grasp_trials import OBJECTS, read_error, typical
from testbed import figures, report
from testbed.report import Array, Row

METHODS = {"can": "best, table", "box": "best, outside, table"}


def compared(name: str, options: report.Options) -> tuple[Row, list[tuple[str, Array]]]:
    """A grasp's row of errors; its pictures with titles: as it is, as vision has it, corrected."""
    trial = typical(name, options.trials, options.first_seed)
    seen, ours = trial.vision.T_palm_object, corrected(trial, METHODS[name]).T_palm_object
    row = {"object": name, "seed": trial.scenario.seed, "method": METHODS[name]}
    row |= {"vision_mm": read_error(trial, seen), "corrected_mm": read_error(trial, ours)}
    return row, [
        ("as it is", figures.close_up(trial)),
        (f"vision: {row['vision_mm']:.0f} mm off", figures.close_up(trial, seen)),
        (f"corrected: {row['corrected_mm']:.1f} mm off", figures.close_up(trial, ours, figures.PINK)),
    ]


@report.or_skip
def main() -> None:
    """Chooses a grasp of each object, corrects it, draws."""
    options = report.options(__doc__, trials=11, quick_trials=3)
    found = [compared(name, options) for name in OBJECTS]
    figure, panels = figures.pyplot().subplots(2, 3, figsize=(11, 6.6), layout="constrained")
    for line, (_, pictures) in zip(panels, found, strict=True):
        figures.show_pictures(line, pictures)
    report.write_csv(options.output / "figure_7.csv", [row for row, _ in found])
    figures.save(figure, options.output / "figure_7.png")


if __name__ == "__main__":
    main()
