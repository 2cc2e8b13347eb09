"""What spoils the correction, one nuisance at a time: the same simulated grasps, each with one reading made worse.

The can's answer is by contacts and vision; the box' with outside evidence and the table as well. All other nuisances
keep their usual size, and the rig keeps saying what is usual: it does not know of the one that is changed. Measure: x,
y of the base's centre as the paper has it. Synthetic (MuJoCo).
"""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from handsight.simulation import Nuisances, model_of
from shared import figures, report
from shared.grasp_errors import between, mean_interval
from shared.grasp_methods import rows_of
from shared.grasp_trials import OBJECTS, Trial, grasps, last_instant, trial_of
from testbed.report import Rows

METHODS = {"can": "best", "box": "best, outside, table"}
ARM = 5e-3
"""Torque errors belong to force errors this far off [m]: 0.05 mN m to 10 mN."""
HEIGHT = 0.8
"""Vision's error in height, in parts of the one in the plane."""
PANELS = 5
"""Beside each other."""
Setting = dict[str, float]
"""Of the nuisances, by name."""
Settings = dict[str, tuple[str, dict[float, Setting]]]
COLOURS = {"can": "#3b6fb6", "box": "#c2571a"}


def settings() -> Settings:
    """By nuisance: its unit, and value in that unit → the settings that make it."""
    return {
        "joint offset": ("°", {v: {"joint_offset": np.deg2rad(v)} for v in (0, 0.5, 1, 2, 3)}),
        "joint noise": ("°", {v: {"joint_noise": np.deg2rad(v)} for v in (0, 0.1, 0.5)}),
        "force noise": ("mN", {v: _load("noise", v) for v in (0, 10, 20, 50)}),
        "force bias": ("mN", {v: _load("bias", v) for v in (0, 20, 50, 100)}),
        "force drift": ("mN/s", {v: _load("drift", v) for v in (0.1, 10, 50)}),
        "tip compliance": ("µm/N", {v: {"tip_compliance": 1e-6 * v} for v in (0, 20, 100, 300)}),
        "object scale": ("", {v: {"object_scale": v} for v in (0.97, 0.985, 1, 1.015, 1.03)}),
        "dent in the model": ("mm", {v: {"object_dent": 1e-3 * v} for v in (0, 2, 5)}),
        "noise of a scan": ("mm", {v: {"object_scan": 1e-3 * v} for v in (0, 0.5, 1, 2)}),
        "table's height": ("mm", {v: {"table_height": 1e-3 * v} for v in (0, 3, 10)}),
        "table's tilt": ("°", {v: {"table_tilt": np.deg2rad(v)} for v in (0, 1, 3)}),
        "vision's shift": ("cm", {v: _shift(v / 100) for v in (2, 4, 8, 12)}),
        "vision's turn": ("°", {v: {"camera_rotation": np.deg2rad(v)} for v in (0, 6, 12)}),
        "contacts": ("", {n: {"contacts": n} for n in (5, 4, 3, 2)}),
    }


def _load(kind: str, mN: float) -> Setting:
    return {f"force_{kind}": 1e-3 * mN, f"torque_{kind}": ARM * 1e-3 * mN}


def _shift(metres: float) -> Setting:
    return {"camera_position": metres, "camera_height": HEIGHT * metres}


def changed(trial: Trial, setting: Setting, rng: np.random.Generator) -> Trial | None:
    """The grasp with that setting; None where it has not so many contacts, or no finger touches."""
    if "contacts" in setting:
        return _fewer(trial, int(setting["contacts"]), rng)
    usual = Nuisances()
    if all(np.isclose(getattr(usual, key), value, rtol=1e-9, atol=0) for key, value in setting.items()):
        return trial
    scenario = replace(trial.scenario, nuisances=replace(usual, **setting))
    same_model = not any(key.startswith("object_") for key in setting)
    model = trial.model if same_model else model_of(scenario)
    sample = last_instant(scenario) if same_model else trial.sample
    return trial_of(scenario, sample, model)


def _fewer(trial: Trial, n: int, rng: np.random.Generator) -> Trial | None:
    """With n of its contacts, the thumb's among them."""
    fingers = trial.touch.fingers
    if len(fingers) < n or "th" not in fingers:
        return None
    others = [i for i, finger in enumerate(fingers) if finger != "th"]
    kept = sorted([fingers.index("th"), *rng.choice(others, n - 1, replace=False).tolist()])
    chosen = tuple(fingers[i] for i in kept)
    return replace(trial, touch=replace(trial.touch, fingers=chosen, contacts=trial.contacts.select(kept)))


def run(options: report.Options, chosen: Settings) -> tuple[Rows, Counter[str]]:
    """A row per object, nuisance, value and grasp."""
    rows, left_out = Rows(), Counter[str]()
    for name in OBJECTS:
        trials = list(grasps(name, options.trials, options.first_seed, left_out))
        for k, trial in enumerate(report.progress(trials, f"{name}, each nuisance")):
            for nuisance, (unit, values) in chosen.items():
                for value, setting in values.items():
                    other = changed(trial, setting, options.rng(k))
                    if other is None:
                        left_out[f"{name}: {nuisance} {value:g}"] += 1
                        continue
                    (row,) = rows_of(other, [METHODS[name]])
                    rows.append({"nuisance": nuisance, "value": value, "unit": unit, **row})
    return rows, left_out


def print_table(rows: Rows, chosen: Settings, trials: int) -> None:
    """Mean errors by nuisance and value."""
    cells = []
    for nuisance, (unit, values) in chosen.items():
        for value in values:
            line = [nuisance if value == next(iter(values)) else "", f"{value:g} {unit}".strip()]
            for name in OBJECTS:
                mine = report.chosen(rows, object=name, nuisance=nuisance, value=value)
                if not mine:
                    line += ["", "", ""]
                    continue
                seen, inside = (report.values(mine, key).mean() for key in ("seen", "in 95%"))
                error = between(mean_interval(report.values(mine, "read")))
                line += [error, f"{seen:.1f}", f"{100 * inside:.0f}"]
            cells.append(line)
    columns = ["nuisance", "value"]
    for name in OBJECTS:
        columns += [f"{name} mm", "seen mm", "95 %"]
    report.print_table(
        f"Error of the base's centre, {trials} grasps each (synthetic)",
        columns,
        cells,
        "[95 % interval]. seen: shift and turn in the directions that contacts can see. 95 %: truths in the 95 % "
        f"region. can: {METHODS['can']}; box: {METHODS['box']}.",
    )


def draw(rows: Rows, chosen: Settings, path: Path) -> None:
    """A panel a nuisance: mean error against its size."""
    lines = -(-(len(chosen) + 1) // PANELS)  # one is the legend's
    shape = {"figsize": (3 * PANELS, 2.5 * lines), "squeeze": False}
    figure, panels = figures.pyplot().subplots(lines, PANELS, **shape, sharey=True, layout="constrained")
    for axes, (nuisance, (unit, values)) in zip(panels.flat, chosen.items(), strict=False):
        for name in OBJECTS:
            mine = report.chosen(rows, object=name, nuisance=nuisance)
            x = sorted(report.distinct(mine, "value"))
            mean, low, high = np.array([mean_interval(report.values(mine, "read", value=v)) for v in x]).T
            axes.fill_between(x, low, high, color=COLOURS[name], alpha=0.18, linewidth=0)
            axes.plot(x, mean, "o-", color=COLOURS[name], markersize=4, label=f"{name}: {METHODS[name]}")
        axes.set_xlabel(f"{nuisance} [{unit}]" if unit else nuisance)
        if nuisance == "contacts":
            axes.set_xticks(sorted(values))
    panels[0, 0].set_ylim(0, None)
    for axes in panels[:, 0]:
        axes.set_ylabel("error [mm]")
    for axes in panels.flat[len(chosen) :]:
        axes.axis("off")
    last = panels.flat[len(chosen)]
    handles, labels = panels[0, 0].get_legend_handles_labels()
    last.legend(handles, labels, loc="center", title="base's centre, mean and 95 % interval")
    figures.save(figure, path)


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    every = settings()
    arguments.add_argument(
        "--only", action="append", choices=every, help="a nuisance; repeatable (default: all)"
    )
    options, given = report.parsed(arguments, trials=20, quick_trials=2)
    chosen = {name: every[name] for name in given.only or every}
    rows, left_out = run(options, chosen)
    print_table(rows, chosen, options.trials)
    if left_out:
        report.say("Left out: " + "; ".join(f"{why} ({n})" for why, n in left_out.items()))
    report.write_csv(options.output / "sensitivity.csv", rows)
    draw(rows, chosen, options.output / "sensitivity.png")


if __name__ == "__main__":
    main()
