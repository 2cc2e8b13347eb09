"""Poses from hundreds of contacts: patches of links that are out of place, some contacts wrong. All synthetic.

Contacts are within 0.15 mm (0.3 where there are 300) and 2 or 3 degrees of the surface; each of 5 or 10 patches is
shifted by 0.5 mm and turned by 1.1 degrees, per axis; wrong ones are 10 mm off, with any normal. Vision is within 10 mm
and 6 degrees, per axis. No constant was chosen on the meshes.

  NEES     squared error by the answer's information, per degree of freedom
  in 95 %  share of answers whose 95 % region holds the true pose
  found    share of the wrong contacts among `outliers`;  false: share of the right ones
"""

import time

import numpy as np
from scipy.stats import chi2

import handsight as hs
from handsight import se3
from handsight.objects import nearest
from testbed import report, scenes, ycb

CASES = {
    "1 000 of 5 patches": scenes.ManyOptions(),
    "1 000 of 5, 10 % wrong": scenes.ManyOptions(wrong=0.1),
    "300 of 10, 2 % wrong": scenes.ManyOptions(
        contacts=300, groups=10, sigma_point=3e-4, sigma_normal=0.05, wrong=0.02
    ),
    "329 alone, 1 mm": scenes.ManyOptions(contacts=329, groups=0, sigma_point=1e-3, sigma_normal=0.05),
    "329 alone, 20 % wrong": scenes.ManyOptions(
        contacts=329, groups=0, sigma_point=1e-3, sigma_normal=0.05, wrong=0.2
    ),
}
SHOWN = "box", "can", "pitcher_base"
"""Two primitives and the mesh with the largest errors; the others are details."""
MESHES = "006_mustard_bottle", "011_banana", "019_pitcher_base"
CELLS = {
    "mm": report.of("shift", ".2f", np.median),
    "°": report.of("turn", ".2f", np.median),
    "NEES": report.of("nees"),
    "median": report.of("nees", ".2f", np.median),
    "in 95 %": report.of("inside"),
    "found": report.of("found"),
    "false": report.of("false", ".2%"),
    "consistent": report.of("consistent"),
}
GROWTH = (100, 300, 1000, 3000, 10_000, 20_000)


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=100, quick_trials=8)
    models = {"box": scenes.box(), "can": scenes.can()}
    if (folder := ycb.data_folder()) is not None:
        files = {name[4:]: folder / "ycb_meshes" / f"{name}.ply" for name in MESHES}
        models |= {name: hs.ObjectModel.from_file(file) for name, file in files.items()}
    rows = report.Rows()
    for m, (name, model) in enumerate(models.items()):
        for c, (case, of) in enumerate(CASES.items()):
            for k in range(options.trials):
                key = {"object": name, "contacts": case, "trial": k}
                rows.append(key | solved(model, of, options.rng(m, c, k)))
    title = "Poses from many contacts (synthetic)"
    report.print_by(title, [row for row in rows if row["object"] in SHOWN], "object, contacts", CELLS)
    others = [row for row in rows if row["object"] not in SHOWN]
    report.print_by(title, others, "object, contacts", CELLS, detail=True)
    growth = []
    for n in GROWTH:
        of = scenes.ManyOptions(contacts=n, wrong=0.02)
        times = [solved(scenes.box(), of, options.rng(9, n, k))["ms"] for k in range(options.trials // 5 + 2)]
        growth.append([n, f"{np.median(times):.1f}"])
    report.print_table(
        "Time of a correction", "contacts on the box, 5 patches, 2 % wrong | ms", growth, detail=True
    )
    report.write_csv(options.output / "many_contacts.csv", rows)


def solved(model: hs.ObjectModel, of: scenes.ManyOptions, rng: np.random.Generator) -> dict[str, float]:
    """The errors of one answer."""
    scene = scenes.many_scene(model, rng, of)
    begin = time.perf_counter()
    estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision)
    took = time.perf_counter() - begin
    truth = nearest(model.symmetries, scene.T_palm_object[None], estimate.T_palm_object, model.radius)[0]
    error, freedom = se3.difference(estimate.T_palm_object, truth), 6 - len(model.symmetries.axes)
    square = float(error @ estimate.information @ error)
    called = np.zeros(len(scene.wrong), dtype=bool)
    called[list(estimate.outliers)] = True
    return {
        "shift": 1e3 * float(np.linalg.norm(error[:3])),
        "turn": float(np.rad2deg(np.linalg.norm(error[3:]))),
        "nees": square / freedom,
        "inside": float(square < chi2.ppf(0.95, freedom)),
        "found": float(called[scene.wrong].mean()) if scene.wrong.any() else np.nan,
        "false": float(called[~scene.wrong].mean()),
        "consistent": float(estimate.consistent),
        "ms": 1e3 * took,
    }


if __name__ == "__main__":
    main()
