"""What was measured of an object in a file, kept whole: the file is neither read nor built a second time."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from handsight.objects import cache
from handsight.objects.fields.field import GridField
from handsight.objects.fields.field_error import Roughness
from handsight.objects.files.read import content
from handsight.objects.geometry import frozen, measured
from handsight.objects.meshes.triangles import Surface, Triangles

_GRIDS = ("coarse", "fine")
_ARRAYS = ("points_object", "normals_object", "bounds_object", "vertices", "faces")
_SIZES = ("area", "diameter", "sigma_point", "sigma_normal", "closed")
_KEPT = {*_GRIDS, *_ARRAYS, "sizes", "remarks", "roughness", "grids", "areas", "normals"}


def measured_file(path: str | os.PathLike[str], scale: float, samples: int) -> dict[str, Any]:
    """As `measured`, of the object in a file whose unit is `scale` metres; raises InvalidFile, InvalidObject."""
    file, data = Path(path), content(path)
    # By name as well: remarks begin with it, and its end says what the bytes mean.
    name = cache.key("file", f"{scale!r} {samples} {file.name}", np.frombuffer(data, dtype=np.uint8))
    arrays = cache.remembered(name, _KEPT, lambda: _arrays(_built(file, data, scale, samples)))
    return {"name": file.stem, **_values(arrays)}


def _built(file: Path, data: bytes, scale: float, samples: int) -> dict[str, Any]:
    from handsight.objects.build import made_of_file  # it brings scipy and trimesh

    return measured(made_of_file(file, data, scale), samples)


def _arrays(values: dict[str, Any]) -> cache.Arrays:
    surface, rough = values["_surface"], values["roughness"]
    cloud = not isinstance(surface, Triangles)
    grids = [np.append(values[k].origin, values[k].cell) for k in _GRIDS]
    return {
        **{k: values[k].values for k in _GRIDS},
        **{k: values[k] for k in _ARRAYS},
        "sizes": np.array([values[k] for k in _SIZES], dtype=np.float64),
        "remarks": np.array(values["remarks"], dtype=np.str_),
        "roughness": rough.values,
        "grids": np.stack([*grids, np.append(rough.origin, rough.cell)]),
        "areas": surface.areas if cloud else np.empty(0),
        "normals": surface.normals if cloud else np.empty((0, 3)),
    }


def _values(arrays: cache.Arrays) -> dict[str, Any]:
    origins, cells = arrays["grids"][:, :3], arrays["grids"][:, 3]
    sizes = dict(zip(_SIZES, arrays["sizes"].tolist(), strict=True))
    surface: Surface = Triangles(arrays["vertices"], arrays["faces"])
    if len(arrays["areas"]):
        from handsight.objects.cloud import Cloud  # it brings scipy

        surface = Cloud(arrays["vertices"], arrays["normals"], arrays["areas"])
    return {
        **{k: GridField(origins[i], float(cells[i]), arrays[k]) for i, k in enumerate(_GRIDS)},
        **{k: frozen(arrays[k]) for k in _ARRAYS},
        **sizes,
        "closed": bool(sizes["closed"]),
        "remarks": tuple(str(remark) for remark in arrays["remarks"]),
        "roughness": Roughness(origins[2], float(cells[2]), arrays["roughness"]),
        "_surface": surface,
    }
