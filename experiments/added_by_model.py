"""What a model adds to the noise of a contact: the field's error, and the point's noise over a bent surface.

A contact's distance and normal are compared with the model's where it is measured. To the noise of the finger come
how far the field is off the object's own surface there (`ObjectModel.field_error`), and, as a point off by its noise
meets another normal of a bent surface, N Σ_pp Nᵀ, with N the normal's derivative. A measured sigma of a normal that
compares contacts with a model at known poses has both in it already: `Contacts(..., of_residual=True)` adds nothing.
Places are drawn evenly from each surface; sigmas per axis.
"""

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import RegularGridInterpolator

import handsight as hs
from shared import report, scenes, ycb
from testbed.report import Array, Rows

SIGMA_POINT, SIGMA_NORMAL = 1e-3, 0.1
"""Of the finger [m, rad]: the defaults of `Contacts`."""
COLUMNS = ("object", "field mm", "field °", "9 of 10", "bend °", "9 of 10 ", "whole °", "9 of 10  ")


def added(model: hs.ObjectModel, places: int) -> tuple[Array, Array, Array]:
    """(n,) standard deviations at places of the surface: the field's distance [m], its normal and the bend's [rad]."""
    points, _ = model.sample(places)
    _, gradient, hessian = model.evaluate(points)
    length = np.linalg.norm(gradient, axis=1)
    normals = gradient / length[:, None]
    along = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    bend = along @ hessian / length[:, None, None]
    turned = SIGMA_POINT * np.sqrt((bend**2).sum(axis=(1, 2)) / 2)
    error, off = model.field_error, np.zeros((len(points), 2))
    if error is not None:
        axes = [
            o + error.cell * np.arange(n) for o, n in zip(error.origin, error.values.shape[:3], strict=True)
        ]
        inside = np.clip(points, error.origin, [axis[-1] for axis in axes])
        off = np.sqrt(RegularGridInterpolator(axes, error.values)(inside))
    return off[:, 0], off[:, 1], turned


def row(name: str, model: hs.ObjectModel, places: int) -> dict[str, object]:
    """Medians, and what nine of ten places are below."""
    distance, normal, turned = added(model, places)
    whole = np.sqrt(SIGMA_NORMAL**2 + normal**2 + turned**2)
    cells: dict[str, object] = {"object": name, "field mm": 1e3 * float(np.median(distance))}
    for column, last, angles in zip(COLUMNS[2::2], COLUMNS[3::2], (normal, turned, whole), strict=True):
        cells[column], cells[last] = (float(np.rad2deg(np.quantile(angles, q))) for q in (0.5, 0.9))
    return cells


def models() -> Iterator[tuple[str, hs.ObjectModel]]:
    """Exact shapes, and the meshes of the data folder where it is."""
    yield "cylinder, exact", scenes.can()
    yield "box, exact", scenes.box()
    folder = ycb.data_folder()
    if folder is not None:
        for path in sorted((folder / "ycb_meshes").glob("*.ply")):
            yield path.stem, hs.ObjectModel.from_file(path)


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=4000, quick_trials=400)
    rows: Rows = [row(name, model, options.trials) for name, model in models()]
    cells = [[f"{x:.2f}" if isinstance(x, float) else x for x in r.values()] for r in rows]
    report.print_table(
        f"What is added to a contact's noise, at {options.trials} places of each surface",
        COLUMNS,
        cells,
        "Medians, each with what 9 of 10 places are below. field: the model's own error. bend: of a point 1 mm off "
        "per axis. whole: with a finger's 5.7° (0.1 rad).",
    )
    report.write_csv(options.output / "added_by_model.csv", rows)


if __name__ == "__main__":
    main()
