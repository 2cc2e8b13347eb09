"""Objects by name: each is added once to a library with its mass and symmetries, then loaded by its name."""

import tempfile
from pathlib import Path

import numpy as np

import handsight as hs
from handsight.objects import Facts, Library, declared_symmetries

folder = Path(tempfile.mkdtemp())
corners = 30.0 * np.array([(x, y, z) for x in (-1, 1) for y in (-1.5, 1.5) for z in (-2, 2)])  # millimetres
sides = ["0 1 3 2", "4 6 7 5", "0 4 5 1", "2 3 7 6", "0 2 6 4", "1 5 7 3"]
lines = [
    "OFF",
    "8 6 0",
    *(" ".join(map(str, corner)) for corner in corners),
    *(f"4 {side}" for side in sides),
]
(folder / "tea.off").write_text("\n".join(lines))

library = Library(folder / "library")
measured = hs.ObjectModel.from_file(folder / "tea.off", scale=1e-3)
entry = library.add(
    folder / "tea.off",
    Facts(name="tea", mass=0.12, center_of_mass=(0, 0, -0.004), sigma_center_of_mass=0.003, licence="CC0"),
    scale=1e-3,
    symmetries=declared_symmetries(measured, ["z/2", "x/2"]),
)
print(f"{entry.name}: object {entry.number}, {1e3 * entry.diameter:.0f} mm, {entry.facts.mass} kg")

model = library.model("tea")
contacts = hs.Contacts([[0.030, 0.01, 0.02], [-0.030, 0.01, 0.02]], sigma_point=1e-3)
vision = hs.PosePrior.from_sigmas(np.eye(4), sigma_position=0.01, sigma_rotation=0.1)
print(hs.correct_pose(model, contacts, vision=vision).T_palm_object.round(4))
