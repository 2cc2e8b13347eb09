"""What golden problems are about: objects and where they are touched, made with NumPy, and those of the data folder."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import handsight as hs
from handsight.objects import propose_symmetries

Array = np.ndarray
Shape = tuple[Array, Array]
"""Vertices (k, 3) [m] and triangles (m, 3)."""
MESHES = ("006_mustard_bottle", "011_banana", "019_pitcher_base", "036_wood_block")
SYMMETRIC = "036_wood_block"
SCANNED = ("box", "post", "006_mustard_bottle")


def data(*parts: str) -> Path:
    """Returns a path in the data beside handsight: in $HANDSIGHT_DATA, else `shared/data` beside the checkout."""
    named = os.environ.get("HANDSIGHT_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"
    return folder.joinpath(*parts)


def mesh(*parts: str) -> Shape:
    """Returns the triangles of a mesh among the data."""
    loaded = trimesh.load_mesh(data(*parts), process=False)
    return np.asarray(loaded.vertices, dtype=float), np.asarray(loaded.faces, dtype=np.int64)


def lathe(profile: Any, sides: int) -> Shape:
    """Returns the surface of a profile of (radius, height) [m], from below, turned about z and open at its ends."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    vertices = np.concatenate([radius * ring + [0, 0, height] for radius, height in profile])
    here = np.arange((len(profile) - 1) * sides)
    beside = here // sides * sides + (here + 1) % sides
    faces = np.concatenate(
        [
            np.stack(three, axis=1)
            for three in ((here, beside, beside + sides), (here, beside + sides, here + sides))
        ]
    )
    used, places = np.unique(vertices, axis=0, return_inverse=True)
    faces = places.reshape(-1)[faces]
    return used, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def on(shape: Shape, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Returns points (n, 3) anywhere on a surface [m], and its outward normals (n, 3) there."""
    corners = shape[0][shape[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(size), n, p=size / size.sum())
    points = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), n), corners[chosen])
    return points, normals[chosen] / size[chosen, None]


def transform(rng: np.random.Generator, length: float, angle: float) -> Array:
    """Returns a random transform (4, 4) of that root mean square length [m] and angle [rad]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle / np.sqrt(3) * rng.normal(size=3)).as_matrix()
    T[:3, 3] = length / np.sqrt(3) * rng.normal(size=3)
    return T


def made() -> dict[str, Shape]:
    """Returns surfaces by name: a can, a box, a ball, a post that is not convex, an open bowl, and four meshes."""
    cube = lathe([(0, -0.5), (0.5**0.5, -0.5), (0.5**0.5, 0.5), (0, 0.5)], 4)
    turned = cube[0] @ Rotation.from_rotvec([0, 0, np.pi / 4]).as_matrix()
    arc = np.linspace(0, np.pi, 33)
    own = {
        "can": lathe([(0, -0.0575), (0.033, -0.0575), (0.033, 0.0575), (0, 0.0575)], 256),
        "box": (turned * (0.06, 0.09, 0.14), cube[1]),
        "ball": lathe(0.04 * np.stack([np.sin(arc).round(12), -np.cos(arc)], axis=1), 64),
        "post": lathe([(0, 0), (0.05, 0), (0.02, 0.03), (0.02, 0.08), (0.035, 0.1), (0, 0.12)], 5),
        "bowl": lathe([(0.03, 0), (0.05, 0.02), (0.06, 0.05)], 48),
    }
    return own | {name: mesh("ycb_meshes", f"{name}.ply") for name in MESHES}


def models(shapes: dict[str, Shape]) -> dict[str, Any]:
    """Returns the models of these surfaces by name, and of three of them as scans, of noisy points."""
    found: dict[str, Any] = {
        "can": hs.ObjectModel.cylinder(radius=0.033, height=0.115),
        "box": hs.ObjectModel.box((0.06, 0.09, 0.14)),
        "ball": hs.ObjectModel.sphere(0.04),
    }
    found |= {name: hs.ObjectModel.from_mesh(*shapes[name]) for name in ("post", "bowl")}
    found |= {name: hs.ObjectModel.from_file(data("ycb_meshes", f"{name}.ply")) for name in MESHES}
    found[SYMMETRIC] = found[SYMMETRIC].with_symmetries(propose_symmetries(found[SYMMETRIC]))
    for k, name in enumerate(SCANNED):
        rng = np.random.default_rng([7, k])
        points, normals = on(shapes[name], rng, 3000)
        points, normals = (
            each + size * rng.normal(size=(3000, 3)) for each, size in ((points, 5e-4), (normals, 0.1))
        )
        found[f"scan of {name}"] = hs.ObjectModel.from_points(points, normals if k % 2 == 0 else None)
    return found
