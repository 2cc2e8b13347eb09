"""Cameras from the files that drivers, calibrations and pose estimators write, told apart by their content.

What is read: JSON or YAML with the camera matrix, or with focal lengths and principal point, under the names that are
common (of handsight, ROS, OpenCV, Open3D, RealSense, BOP, MegaPose, SAM-6D, Kalibr, ORB-SLAM), in the file itself or
in a part of it; or a text of 3 x 3 or 4 x 4 numbers. Beside them may stand the unit of depth images, which
programs state in three ways; their values tell them apart.
"""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from handsight import checks
from handsight.camera import Camera
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_text
from handsight.msgspec_errors import decode_object
from handsight.rig.yaml_file import YamlFile

Values = Mapping[str, object]
Named = Mapping[str, tuple[str, object]]
"""Values by their plain names, each with the name that the file has, with those of the mappings around it."""
Unit = tuple[str, float]
"""Key and number by which a file states the unit of its depth images, where they are whole numbers."""
Size = tuple[int, int]
"""Width and height [pixels]."""
MAX_BYTES = 100_000_000
"""Of a file: that of a BOP scene has a camera for each of a hundred thousand images."""
MAX_DEPTH = 3
"""Levels of mappings in which a camera is looked for."""
FORMS = (
    "fx, fy, cx, cy [pixels], a camera matrix (K, cam_K, camera_matrix, intrinsic_matrix), "
    "or a text of 3 x 3 or 4 x 4 numbers"
)
MATRIX = ("matrix", "k", "camk", "cameramatrix", "intrinsicmatrix", "intrinsics", "intrinsic", "mtx")
"""Names of a matrix, as `_plain_name` has them; those below too."""
FOCAL = {"fx": ("fx", "flx"), "fy": ("fy", "fly"), "cx": ("cx", "ppx"), "cy": ("cy", "ppy")}
WIDTH = ("width", "imagewidth", "w")
HEIGHT = ("height", "imageheight", "h")
SIZE = ("resolution", "imagesize", "imgsize", "size")
LENS = (
    *("lens", "d", "distcoeffs", "distortioncoefficients", "distortioncoeffs", "distortion"),
    *("coeffs", "disto", "dist"),
)
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""In the order of OpenCV and of `Camera.lens`."""
MODEL = ("distortionmodel", "model", "cameramodel")
FISHEYE = ("equidistant", "fisheye", "kannala", "ftheta", "inverse", "modified", "omni", "double", "fov")
"""Words in the names of models whose coefficients are not those of `Camera.lens`."""
UNITS = (
    *("depthscale", "depthfactor", "depthmapfactor", "pngdepthscale", "depthunits"),
    "depthunitscalefactor",
)
"""Names of the unit of depth images that are whole numbers."""
MOST_METRES = 0.01
LEAST_STEPS = 100.0
"""A unit up to the first is metres a step (RealSense), from the second on steps a metre (TUM, ORB-SLAM, NICE-SLAM), and
between them millimetres a step (BOP)."""


@dataclass(frozen=True, slots=True)
class _Described:
    """A camera as a file describes it."""

    K: tuple[tuple[float, ...], ...]
    lens: tuple[float, ...]
    sides: tuple[Size, ...]
    """The sizes that the file may mean; none: it has none."""
    unit: Unit | None = None
    key: str = field(default="matrix", compare=False)
    """What the file calls the matrix."""

    def of_size(self, size: Size | None) -> Camera:
        """Returns the camera, whose images have a size; None: that of the file. Raises InvalidInput."""
        if size is None and len(self.sides) != 1:
            raise InvalidInput("width: expected width and height of its images, got none; give their size")
        if size is not None and self.sides and size not in self.sides:
            came = " x ".join(map(str, self.sides[0]))
            expected = f"expected {size[0]} x {size[1]} pixels as the image's"
            hint = "if the image was resized, --resized scales it"
            raise InvalidInput(f"size: {expected}, got {came} ({hint})")
        return Camera(np.array(self.K), size or self.sides[0], np.array(self.lens))


@dataclass(frozen=True, slots=True)
class CameraFile:
    """The cameras in a file."""

    path: Path
    found: Mapping[str, _Described]
    """By the last of the keys that lead to them, such as the number of an image; empty for the file itself."""

    def camera(self, size: Size | None = None, image: str = "", *, resized: bool = False) -> Camera:
        """Returns the camera of an image; arguments and errors are `read_camera`'s."""
        described = self._of(image)
        try:
            if not resized:
                return described.of_size(size)
            return described.of_size(None).resized(size or described.sides[0])
        except InvalidInput as error:
            message = re.sub(r"\Amatrix:", f"{described.key}:", str(error))
            raise InvalidFile(f"{self.path}: {message}") from None

    def step(self, image: str = "") -> tuple[float | None, str]:
        """Returns the metres of a step of whole numbers in a depth image, None where the file does not state them, and
        a sentence on how it does; raises InvalidFile."""
        unit = self._of(image).unit
        if unit is None:
            return None, ""
        key, number = unit
        metres = 1e-3 * number
        if number <= MOST_METRES:
            metres = number
        elif number >= LEAST_STEPS:
            metres = 1 / number
        return metres, f"{key} {number:g} of {self.path.name}: {1e3 * metres:.4g} mm a step of depth"

    def _of(self, image: str) -> _Described:
        """Returns the camera of an image, of that number if there is one for each; raises InvalidFile."""
        number = re.search(r"\d+$", image)
        numbered = {int(key): one for key, one in self.found.items() if key.isdecimal()}
        if number and int(number[0]) in numbered:
            return numbered[int(number[0])]
        first = next(iter(self.found.values()))
        if any(other != first for other in self.found.values()):
            came = checks.brief(", ".join(self.found))
            raise InvalidFile(f"{self.path}: expected one camera, got different ones: {came}")
        return first


def read_camera(
    path: str | Path, *, size: Size | None = None, image: str = "", resized: bool = False
) -> Camera:
    """Returns the camera of a file; see the top of this module for what is read.

    `size`: width and height of its images [pixels], where the file may have none; one that it has must be the same,
    unless the images were `resized`: then the camera is, too. `image`: the name of an image, whose number is that of
    its camera in a file with one for each. Raises InvalidFile, which names the file and the key, and MissingExtra.
    """
    return read_camera_file(path).camera(size, image, resized=resized)


def read_camera_file(path: str | Path) -> CameraFile:
    """Returns all cameras of a file; raises InvalidFile where there is none, MissingExtra."""
    document = _document(path)
    try:
        if isinstance(document, Mapping):
            found = dict(_cameras(document, (), None))
        else:
            numbers = document[0] if len(document) == 1 else document
            found = {"": _Described(_matrix(numbers, "matrix"), (), ())}
        if not found:
            raise InvalidInput(f"expected a camera, {FORMS}, got neither")
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None
    return CameraFile(Path(path), found)


def _document(path: str | Path) -> Values | Array:
    """Returns the content of a file: a mapping of names to values, or rows of numbers."""
    text = read_text(path, MAX_BYTES, f"a text with {FORMS}")
    if text.lstrip().startswith(("{", "[")) and (":" in text or text.rstrip().endswith("]")):
        return decode_object(text.encode(), str(path))
    rows = [line.replace(",", " ").split() for line in text.splitlines() if line.strip()]
    try:
        return np.array([[float(word) for word in row] for row in rows if not row[0].startswith("#")])
    except ValueError:  # words, or rows of different lengths
        pass
    if ":" not in text:
        came = text.strip().partition("\n")[0]
        raise InvalidFile(f"{path}: expected a camera, {FORMS}, got {came!r:.60}")
    # OpenCV's dialect: a header that is no YAML, and tags. `rostopic echo` ends with the begin of another document.
    text = re.sub(r"\A%YAML.*", "", text).replace("!!opencv-matrix", "")
    text = re.sub(r"\n---\s*\Z", "\n", text)
    return YamlFile(Path(path), text).values


def _cameras(values: Values, place: tuple[str, ...], unit: Unit | None) -> Iterator[tuple[str, _Described]]:
    """Yields the cameras that a mapping describes itself, else those in its parts, by the last key of their places.

    `unit`: of depth images, as a mapping around this one states it.
    """
    named = {_plain_name(key): (".".join([*place, key]), value) for key, value in values.items()}
    for name in UNITS:
        key, value = named.get(name, ("", {}))
        if not isinstance(value, Mapping):
            unit = key.rpartition(".")[2], checks.positive(value, key)  # type: ignore[arg-type]
    matrix, K = _intrinsics(named)
    if K:
        yield place[-1] if place else "", _Described(K, _lens(named), _sides(named), unit, matrix)
        return
    for key, part in values.items():
        if isinstance(part, Mapping) and len(place) + 1 < MAX_DEPTH:
            yield from _cameras(part, (*place, key), unit)


def _plain_name(key: str) -> str:
    """Returns a name without what is written in several ways: `Camera.fx`, `camera_matrix` and `cameraMatrix`."""
    return re.sub("[^a-z0-9]", "", key.rpartition(".")[2].lower())


def _intrinsics(named: Named) -> tuple[str, tuple[tuple[float, ...], ...]]:
    """Returns the camera matrix (3, 3) that names describe, and its own name; empty where they describe none."""
    for key, numbers in _listed(named, MATRIX):
        return key, _matrix(numbers, key)
    single = {name: _number(named, names) for name, names in FOCAL.items()}
    missing = [name for name, value in single.items() if value is None]
    if {"fx", "fy"} <= {*missing}:
        return "matrix", ()
    if missing:
        raise InvalidInput(f"{missing[0]}: expected a number, got nothing")
    return "matrix", _matrix(np.array([*single.values()]), "matrix")


def _matrix(numbers: Array, name: str) -> tuple[tuple[float, ...], ...]:
    """Returns a camera matrix (3, 3) from 3 x 3, 3 x 4 or 4 x 4 numbers, from 9, in rows or in columns (which the last
    row of a camera matrix tells), or from fx, fy, cx, cy; raises InvalidInput."""
    if numbers.shape == (4,):
        fx, fy, cx, cy = numbers.tolist()
        return (fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)
    if numbers.size in (9, 12, 16) and numbers.ndim <= 2:
        rows = 4 if numbers.size == 16 else 3
        square = numbers.reshape(rows, -1)
        if numbers.ndim == 1 and (square[:2, 2] == 0).all() and (square[2, :2] != 0).any():
            square = square.T  # as Open3D writes them
        if not square[:3, 3:].any():
            return tuple(map(tuple, checks.finite(square[:3, :3], name, (3, 3)).tolist()))
    expected = "expected 3 x 3 or 4 x 4 numbers of a camera matrix"
    raise InvalidInput(f"{name}: {expected}, got {checks.brief(numbers)}")


def _lens(named: Named) -> tuple[float, ...]:
    """Returns the coefficients of the lens (n,), none where all are 0; raises InvalidInput for another kind of lens,
    and for one under an unknown name, which would otherwise count as none."""
    for key, _ in _listed(named, [name for name in named if re.search("lens|dist", name)]):
        if _plain_name(key) not in LENS:
            expected = f"expected a lens under a known name ({', '.join(LENS[:4])})"
            raise InvalidInput(f"{key}: {expected}, got this key")
    lens = np.zeros(0)
    for key, numbers in _listed(named, LENS):
        lens = numbers.ravel()
        if 0 < len(lens) < 4:
            raise InvalidInput(f"{key}: expected 0, 4, 5, 8 numbers, got {len(lens)}")
    if named.keys() & {*COEFFICIENTS}:
        lens = np.array([_number(named, (name,)) or 0.0 for name in COEFFICIENTS])
    coefficients = np.trim_zeros(lens, "b").tolist()
    if not coefficients:
        return ()
    models = [value for name in MODEL for _, value in [named.get(name, ("", ""))] if isinstance(value, str)]
    if re.search("|".join(FISHEYE), " ".join(models).lower()):
        expected = "expected plumb_bob or rational_polynomial"
        raise InvalidInput(f"distortion_model: {expected}, got {models}; rectify the images first")
    count = next((n for n in (4, 5, 8) if n >= len(coefficients)), 0)
    return (*coefficients, *[0.0] * (count - len(coefficients)))


def _sides(named: Named) -> tuple[Size, ...]:
    """Returns width and height that names describe; both orders of a pair, which some write with the height first."""
    width = _number(named, WIDTH)
    height = _number(named, HEIGHT)
    if width is not None and height is not None:
        if not (width.is_integer() and height.is_integer()):
            raise InvalidInput(f"width: expected whole numbers of pixels, got {width:g} x {height:g}")
        return ((int(width), int(height)),)
    for _, pair in _listed(named, SIZE):
        if pair.shape == (2,):
            first, second = pair.astype(int).tolist()
            return (first, second), (second, first)
    return ()


def _number(named: Named, names: Iterable[str]) -> float | None:
    """Returns the number under one of the names of a quantity; raises InvalidInput where it is none."""
    for name in names:
        if name in named:
            key, value = named[name]
            return float(checks.finite(value, key, ()))  # type: ignore[arg-type]
    return None


def _listed(named: Named, names: Iterable[str]) -> Iterator[tuple[str, Array]]:
    """Yields what the file calls those of some names that have numbers in a list, in lists of them, or under `data`, as
    OpenCV and ROS have them; and these."""
    for name in names:
        key, value = named.get(name, ("", None))
        if isinstance(value, Mapping):
            value = value.get("data")
        if isinstance(value, list):
            with contextlib.suppress(ValueError, TypeError):
                yield key, np.array(value, dtype=float)
