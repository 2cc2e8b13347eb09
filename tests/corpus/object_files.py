"""Files of objects: meshes and clouds, as text and binary."""

import os
import random
import struct
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.objects import ObjectModel, Symmetries, about, read_shape
from tests.corpus.door import Case, Door, spoilt_bytes, spoilt_text

CORNERS = np.array([[x, y, z] for x in (-30.0, 30) for y in (-45.0, 45) for z in (-25.0, 25)])
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = np.array([[side[0], *side[k : k + 2]] for side in SIDES for k in (1, 2)])
CLOUD = np.random.default_rng(0).normal(size=(40, 3)).round(3)


def words(rows: object, before: str = "") -> str:
    """Returns a line of text for each row."""
    return "".join(before + " ".join(map(str, row)) + "\n" for row in rows)


def stl(kind: str = "binary", off: float = 0.0) -> bytes:
    """Returns the box as STL, each corner of each triangle moved by up to `off` [mm]."""
    corners = CORNERS[FACES] + off * np.random.default_rng(1).uniform(-1, 1, (12, 3, 3))
    if kind == "binary":
        table = np.zeros(12, [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
        table["v"] = corners
        return bytes(80) + struct.pack("<I", 12) + table.tobytes()
    facets = (
        f"facet normal 0 0 1\nouter loop\n{words(each, 'vertex ')}endloop\nendfacet\n" for each in corners
    )
    return f"solid box\n{''.join(facets)}endsolid box\n".encode()


def ply(kind: str = "ascii", faces: list[list[int]] = SIDES, index: str = "vertex_indices") -> bytes:
    """Returns the box as PLY, its faces in the list `index`; the list `weights` is of floats, which no corners are."""
    of = "int" if index != "weights" else "float"
    header = "".join(f"property double {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat {kind} 1.0\ncomment made by hand\nelement vertex 8\n{header}element face {len(faces)}\n"
    )
    header += f"property list uchar {of} {index}\nend_header\n"
    if kind == "ascii":
        return (header + words(CORNERS) + words([len(face), *face] for face in faces)).encode()
    order = "<" if "little" in kind else ">"
    rows = (struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return header.encode() + CORNERS.astype(f"{order}f8").tobytes() + b"".join(rows)


def pcd(kind: str = "ascii") -> bytes:
    """Returns the cloud as PCD."""
    header = (
        f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 40\nHEIGHT 1\nPOINTS 40\nDATA {kind}\n"
    )
    return header.encode() + (words(CLOUD).encode() if kind == "ascii" else CLOUD.astype("<f4").tobytes())


OBJ = (words(CORNERS, "v ") + words((np.array(SIDES) + 1).tolist(), "f ")).encode()
OFF = ("OFF\n8 6 0\n" + words(CORNERS) + words([4, *side] for side in SIDES)).encode()
MIXED = [*SIDES[1:], *FACES[:2].tolist()]
GOOD: list[tuple[str, bytes]] = [
    ("box.stl", stl()),
    ("box.stl", stl("words")),
    ("box.obj", OBJ),
    ("box.obj", b"mtllib /dev/zero\nusemtl /etc/passwd\n" + OBJ),
    ("box.off", OFF),
    ("box.ply", ply()),
    ("box.ply", ply("binary_little_endian")),
    ("box.ply", ply("binary_big_endian", MIXED)),
    ("cloud.pcd", pcd()),
    ("cloud.pcd", pcd("binary")),
    ("cloud.xyz", words(CLOUD).encode()),
]


def saved(name: str, data: bytes, read: Callable[[Path], None]) -> None:
    """Calls a reader on a file with this name and content."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        read(path)


def check_shape(path: Path) -> None:
    """Reads a shape, and asserts that its arrays are of one length and small."""
    shape = read_shape(path)
    assert shape.vertices.ndim == 2
    assert len(shape.vertices) < 10_000
    if shape.faces is not None:
        assert shape.faces.dtype == np.int64
        assert len(shape.faces) < 10_000
    else:
        assert np.isfinite(shape.vertices).all()


def check_object(path: Path) -> None:
    """Builds an object, and asserts that its distances are finite."""
    model = ObjectModel.from_file(path, 0.001)
    at = model.evaluate(model.sample(50)[0])
    assert np.isfinite(at.distance).all()
    assert np.isfinite(at.gradient).all()


def check_sides(path: Path, *, closed: bool) -> None:
    """Asserts that an object is closed or not, and that no distance at a place 5 mm from it is below 2 mm."""
    check_object(path)
    model = ObjectModel.from_file(path, 0.001)
    assert model.closed == closed
    far = 0.1 * np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    spread = model.sample(4000)[0]
    gap = np.sqrt(((far[:, None] - spread[None, ::4]) ** 2).sum(axis=2).min(axis=1))
    assert (np.abs(model.evaluate(far[gap > 0.012]).distance) > 0.002).all()


def spoilt(rng: random.Random) -> tuple[str, bytes]:
    """Returns the name of a valid file, and its corrupted content."""
    name, data = rng.choice(GOOD)
    if rng.random() < 0.5:
        return name, spoilt_text(data.decode("latin-1"), rng).encode("latin-1", "replace")
    return name, spoilt_bytes(data, rng)


def no_file(make: Callable[[Path], object]) -> Callable[[], None]:
    """Returns a call that reads a path that is no regular file."""

    def read() -> None:
        with tempfile.TemporaryDirectory() as folder:
            make(Path(folder) / "a.stl")
            read_shape(Path(folder) / "a.stl")

    return read


def case(name: str, file: str, data: bytes, says: str | None) -> Case:
    """Returns the case of an object built from a file."""
    return Case(name, lambda: saved(file, data, check_object), says)


def sided(name: str, file: str, data: bytes, closed: bool) -> Case:
    """Returns the case of a mesh that must be closed, or open."""
    return Case(name, lambda: saved(file, data, partial(check_sides, closed=closed)), None)


def turned(point: list[float], direction: list[float], order: int | None = None) -> None:
    """Builds the box of a file with a declared turn of this order about a line, any turn if None [mm]."""
    line = np.multiply(point, 1e-3), np.array(direction)
    if order is None:
        declared = Symmetries([line])
    else:
        unit = line[1] / max(float(np.linalg.norm(line[1])), 1e-300)
        declared = Symmetries(rotations=[about(line[0], 2 * np.pi / order * unit)])
    saved("a.stl", stl(), lambda path: check_turned(ObjectModel.from_file(path, 1e-3, symmetries=declared)))


def check_turned(model: ObjectModel) -> None:
    """Asserts that the declared turns of the box take nearly all of its corners next to others."""
    for T in model.symmetries.rotations:
        off = np.linalg.norm(se3.apply(T, model.vertices)[:, None] - model.vertices, axis=-1).min(axis=1)
        assert np.median(off) < 0.01, f"{1e3 * off} mm"


def turned_anyhow(rng: random.Random) -> None:
    """Builds the box with a half turn, or of another order, about its own axis, or one beside it, or one askew."""
    point = [rng.choice([0.0, 0.0, 2.0, 40.0]) for _ in range(3)]
    direction = [*rng.choice(np.eye(3).tolist())]
    direction[rng.randrange(3)] += rng.choice([0.0, 0.0, 0.02, 0.7])
    turned(point, direction, rng.choice([None, 2, 2, 2, 2, 3, 4]))


SIDE = b"f 1 2 4 3\n"
"""One side of the box, as OBJ."""
MOVED = "symmetries: expected turns that leave the surface in place, got one, which is"
BOM = b"\xef\xbb\xbf"
DOORS = [
    Door("read_shape", lambda rng: saved(*spoilt(rng), check_shape), 400),
    Door("ObjectModel.from_file", lambda rng: saved(*spoilt(rng), check_object), 12),
    Door("ObjectModel.from_file(symmetries=)", turned_anyhow, 40),
]
CASES = [
    *(
        Case(f"{name} as it should be, {k}", lambda name=name, data=data: saved(name, data, check_shape), None)
        for k, (name, data) in enumerate(GOOD)
    ),
    *(
        Case(f"{name} behind a mark of UTF-8, {k}", lambda n=name, d=data: saved(n, BOM + d, check_shape), None)
        for k, (name, data) in enumerate(GOOD)
        if data != stl()
    ),
    case("a PLY whose corners are called indices", "a.ply", ply(index="indices"), None),
    case("a binary PLY of mixed polygons", "a.ply", ply("binary_little_endian", MIXED, "corners"), None),
    case("a PLY whose corners are floats", "a.ply", ply(index="weights"), "a.ply: expected a list vertex_indices"),
    case("a PLY with two lists", "a.ply", ply(index="b\nproperty list uchar int c"), "a.ply: face: expected numbers"),
    case("a PLY of a polygon of two", "a.ply", ply(faces=[[0, 1]]), "a.ply: face 0: expected at least 3 corners"),
    case("a PLY with an index before the first", "a.ply", ply(faces=[[0, 1, -1]]), "a.ply: faces: expected indices 0 to 7"),
    case("a PLY with an index past the last", "a.ply", ply(faces=[[0, 1, 8]]), "a.ply: faces: expected indices 0 to 7"),
    case("a PLY with an index of 70 bits", "a.ply", ply(faces=[[0, 1, 2**70]]), "a.ply: face: expected numbers of 64"),
    case("a PLY of 1e18 vertices", "a.ply", ply().replace(b"vertex 8", b"vertex 1%017d" % 0), "rows of 'vertex', got 14"),
    case("an OBJ with index 0", "a.obj", OBJ + b"f 0 1 2\n", "a.obj: faces: expected vertices from 1"),
    case("an OBJ that counts back", "a.obj", OBJ + b"f -1 -2 -8\n", None),
    case("an OBJ that counts back too far", "a.obj", OBJ + b"f -1 -2 -9\n", "a.obj: faces: expected vertices from 1"),
    case("an OBJ that counts back first", "a.obj", b"f -1 -2 -3\n" + OBJ, "a.obj: faces: expected vertices from 1"),
    case("an OBJ past its last vertex", "a.obj", OBJ + b"f 1 2 9\n", "a.obj: faces: expected vertices 1 to 8, got 9"),
    case("a PCD of 4¹ points", "a.pcd", pcd().replace(b"POINTS 40", b"POINTS 4\xb9"), "a.pcd: POINTS: expected"),
    case("an OBJ face of nothing", "a.obj", OBJ + b"f\n", "expected whole numbers"),
    case("an OFF with an index before the first", "a.off", OFF.replace(b"4 0 1", b"4 -1 1"), "a.off: faces: expected indices"),
    case("an OFF with an index past the last", "a.off", OFF.replace(b"4 0 1", b"4 8 1"), "a.off: faces: expected indices"),
    case("a line of two million zeros", "a.xyz", b"0" * 2_200_000, "a.xyz: expected lines of text"),
    case("a word of a million digits", "a.xyz", b"1 2 " + b"9" * 1_000_000, "a.xyz: points"),
    case("a mesh with NaN", "a.obj", OBJ.replace(b"-30.0", b"nan"), "a.obj: vertices[0]: expected 3 finite numbers"),
    case("a mesh 1e300 wide", "a.obj", OBJ.replace(b"-30.0", b"1e300", 1), "a.obj: vertices: expected a size"),
    Case(
        "a scale of 1e308",
        lambda: saved("a.xyz", GOOD[-1][1], lambda path: print(ObjectModel.from_file(path, 1e308))),
        "a.xyz: points: expected finite numbers",
    ),
    sided("an OBJ with a vertex on another's edge", "a.obj", OBJ.replace(SIDE, b"v -30 -45 0\nf 9 2 4 3 1\n"), True),
    sided("an STL that rounds each corner anew", "a.stl", stl(off=1e-3), True),
    sided("an OBJ of a box without a side", "a.obj", OBJ.replace(SIDE, b""), False),
    sided("an OFF of one triangle", "a.off", b"OFF\n3 1 0\n0 0 0\n60 0 0\n0 60 0\n3 0 1 2\n", False),
    Case("a half turn of a mesh", lambda: turned([0, 0, 0], [0, 0, 1], 2), None),
    Case("a half turn of a mesh, 2 mm beside", lambda: turned([2, 0, 0], [0, 0, 1], 2), None),
    Case("a half turn of a mesh, 10 mm beside", lambda: turned([10, 0, 0], [0, 0, 1], 2), MOVED),
    Case("a quarter turn of a mesh", lambda: turned([0, 0, 0], [0, 0, 1], 4), MOVED),
    Case("any turn of a mesh", lambda: turned([0, 0, 0], [0, 0, 1]), MOVED),
    Case("a folder for a file", no_file(os.mkdir), "a.stl: expected a file, got a folder"),
    Case("a pipe for a file", no_file(os.mkfifo), "a.stl: expected a file, got something else"),
    Case("a device for a file", no_file(lambda path: path.symlink_to("/dev/zero")), "a.stl: expected a file, got some"),
    Case("a circle of links", no_file(lambda path: path.symlink_to(path)), "a.stl: cannot be read"),
]  # fmt: skip
