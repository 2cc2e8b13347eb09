"""Depth images and intrinsics in files."""

import io
import json
import random
import struct
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.recording.bop import Hints
from handsight.recording.frames import Beside, Frame, Unread, open_frames
from handsight.vision import locate_all, read_camera, read_color, read_depth
from handsight.vision.object.locate import search_mask
from tests.corpus.door import Case, Door, check_sentence, spoilt_bytes, spoilt_value

STEPS = np.random.default_rng(0).integers(400, 3000, (24, 32)).astype(np.uint16)
CAMERA = {
    "fx": 30.5,
    "fy": 30.0,
    "cx": 15.5,
    "cy": 11.5,
    "width": 32,
    "height": 24,
    "lens": [-0.28, 0.07, 2e-4, 1.6e-5, 0.0],
}


def image(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    """Returns the bytes of an image file with these pixels."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    return stream.getvalue()


PNG, JPEG = image(STEPS), image((STEPS[..., None] // [12, 13, 14]).astype(np.uint8), "JPEG")


def read(data: bytes, reader: Callable[[Path], object]) -> object:
    """Returns the answer of a reader to a file with this content."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        path.write_bytes(data)
        return reader(path)


def depth(data: bytes) -> None:
    """Reads a depth image, and asserts that its pixels are positive, in metres, or NaN."""
    found = read(data, read_depth)
    assert found.dtype == np.float32
    assert (np.isnan(found) | (found > 0)).all()


def color(data: bytes) -> None:
    """Reads a colour image, and asserts its type and shape."""
    found = read(data, read_color)
    assert (found.dtype, found.ndim, found.shape[2]) == (np.uint8, 3, 3)


def camera(value: object) -> None:
    """Reads a camera, and asserts that points on its rays are projected to finite pixels."""
    found = read(json.dumps(value, default=str).encode(), read_camera)
    if found.size[0] * found.size[1] > 10_000:
        return
    rays = found.rays[found.size[1] // 2, found.size[0] // 2].astype(np.float64)
    if np.isfinite(rays).all():
        assert np.isfinite(found.project([[*rays, 1.0]])).all()


SCENE = {"0": {"cam_K": [30.5, 0, 15.5, 0, 30.0, 11.5, 0, 0, 1], "depth_scale": 1.0, "cam_R_w2c": [1] * 9}}


def scene(value: object) -> None:
    """Reads a BOP scene of one image, and asserts that the image has that camera, or that a sentence says why not."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "000001"
        (path / "depth").mkdir(parents=True)
        (path / "depth/000000.png").write_bytes(PNG)
        (path / "scene_camera.json").write_bytes(json.dumps(value, default=str).encode())
        frames = open_frames(path, Beside())
        rows = list(frames.each)
        assert len(rows) == frames.total
        for row in rows:
            if isinstance(row, Unread):
                check_sentence(row.reason)
            else:
                assert (row.camera.size, row.number[0]) == ((32, 24), 1)


def bop_folder(rng: random.Random | None) -> None:
    """Reads a BOP scene of two images of which one file is damaged, renamed or missing."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "000001"
        (path / "depth").mkdir(parents=True)
        (path / "rgb").mkdir()
        files = {"scene_camera.json": json.dumps({"0": SCENE["0"], "1": SCENE["0"]}).encode()}
        files |= {f"depth/00000{k}.png": PNG for k in range(2)} | {
            f"rgb/00000{k}.jpg": JPEG for k in range(2)
        }
        if rng is not None:
            name = rng.choice(sorted(files))
            data = files.pop(name)
            kind, odd = rng.randrange(4), rng.choice(["\x1b[2J", "-1", "1" * 30, "a" * 200, "\udcff"])
            if kind:
                data = spoilt_bytes(data, rng) if kind < 3 else data
                files[name if kind < 3 else str(Path(name).with_stem(odd))] = data
        for name, data in files.items():
            (path / name).write_bytes(data)
        frames = open_frames(path, Beside())
        rows = list(frames.each)
        for row in rows:
            if isinstance(row, Unread):
                check_sentence(row.reason)
                if len(rows) == 1:
                    raise InvalidInput(row.reason)
            else:
                assert row.depth.shape == (24, 32)


FOUND = [
    {
        "scene_id": 1,
        "image_id": 0,
        "category_id": 5,
        "bbox": [3, 4.5, 10, 8],
        "score": 0.7,
        "time": 0.1,
        "segmentation": {"size": [24, 32], "counts": counts},
    }
    for counts in ([100, 20, 648], "T3d0Xd0")
]
POSES = "scene_id,im_id,obj_id,score,R,t,time\n1,0,5,0.9,1 0 0 0 1 0 0 0 1,10 -20 800,0.5\n"
TARGETS = [{"scene_id": 1, "im_id": 0, "obj_id": 5, "inst_count": 2}]


def hints(kind: str, content: bytes, good: bool = False) -> None:
    """Reads a file of another program, and asserts what an image has of it, or that a sentence says why nothing."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "a").write_bytes(content)
        given = Hints(["cup"], {"cup": 5}, **{kind: Path(folder) / "a"})
    lens = Camera(np.array([[30.5, 0, 15.5], [0, 30, 11.5], [0, 0, 1]]), (32, 24))
    for number in ((1, 0), None):
        frame = Frame(name="000000.png", camera=lens, depth=np.ones((24, 32), np.float32), number=number)
        for row in given.beside_each([frame]):
            if isinstance(row, Unread):
                check_sentence(row.reason)
                assert not good, row.reason
                continue
            for each in row.detections or ():
                assert search_mask(lens, each.box, each.mask).shape == (24, 32)
            for Ts in (row.starts or {}).values():
                np.testing.assert_allclose(np.linalg.det(Ts), 1)
            assert all(count > 0 for count in (row.targets or {}).values())


def spoilt(value: object, rng: random.Random) -> bytes:
    """Returns a JSON document that is corrupted in its values or its bytes."""
    if rng.random() < 0.3:
        return spoilt_bytes(json.dumps(value).encode(), rng)
    return json.dumps(spoilt_value(value, rng), default=str).encode()


TURNED = se3.rotation_exp(np.array([0.4, 0.5, 0.2]))
BOXES = {name: hs.ObjectModel.box(size) for name, size in (("a", (0.2, 0.3, 0.1)), ("b", (0.1, 0.1, 0.1)))}


def several(rng: random.Random | None) -> None:
    """Locates all of two boxes in an image of one of them, and asserts that no pixel is explained twice."""
    lens = Camera(np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), (64, 48))
    depth = lens.draw(BOXES["a"].vertices @ TURNED.T + [0, 0, 0.6], BOXES["a"].faces).depth
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 1.5).astype(np.float32)
    given: dict[str, Any] = {"counts": {"a": 2}, "box": [2, 1, 60, 40], "table": [0, 0, -1, 1.5]}
    given |= {name: np.ones(depth.shape, bool) for name in ("mask", "hand")}
    given["hand"][:, 5:] = False
    if rng is not None:
        which = rng.choice([*given, "depth", "models"])
        if which == "depth":
            which, unit = "", rng.choice([1e-3, 0.1, 1.0, 10.0, 1e3])
            odd = rng.choice([np.nan, np.inf, -1.0, 0.0, 1e30])
            depth = np.where(
                np.random.default_rng(rng.getrandbits(32)).random(depth.shape) < 0.2, odd, unit * depth
            )
            depth = depth[rng.choice([0, 0, 1]) :]
        elif which in ("mask", "hand"):
            kind = rng.choice([float, np.int8, np.uint16, str, object])
            given[which] = given[which][rng.choice([0, 0, 1]) :].astype(kind)
        elif which in given:
            given[which] = spoilt_value(given[which], rng)
        given = {name: value for name, value in given.items() if name == which or rng.random() < 0.5}
    answer = locate_all(BOXES, depth, lens, **given)
    assert {each.name for each in answer.instances} | set(answer.missing) == set(BOXES)
    assert (np.sum([each.pixels for each in answer.instances], axis=0) <= 1).all()
    assert all(0 <= each.probability <= 1 for each in answer.instances)


def rows(png: bytes, count: int) -> bytes:
    """Returns a PNG of 16 bits with its header, and only its first rows."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    at = png.index(b"IDAT")
    (length,) = struct.unpack(">I", png[at - 4 : at])
    pixels = zlib.decompress(png[at + 4 : at + 4 + length])
    kept = pixels[: count * (1 + 2 * struct.unpack(">I", png[16:20])[0])]
    return png[: at - 4] + chunk(b"IDAT", zlib.compress(kept)) + chunk(b"IEND", b"")


def masked() -> None:
    """Locates a box in a depth image of which a part is masked."""
    lens = Camera(np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), (64, 48))
    hs.locate(BOXES["a"], np.ma.masked_greater(np.linspace(0.3, 2.0, 48 * 64).reshape(48, 64), 1.0), lens)


DOORS = [
    Door("locate_all", several, 60),
    Door("detections", lambda rng: hints("detections", spoilt(FOUND, rng)), 300),
    Door("targets", lambda rng: hints("targets", spoilt(TARGETS, rng)), 100),
    Door("start", lambda rng: hints("start", spoilt_bytes(POSES.encode(), rng)), 200),
    Door("open_frames", lambda rng: scene(spoilt_value(SCENE, rng)), 200),
    Door("a BOP folder", bop_folder, 100),
    Door("read_depth", lambda rng: depth(spoilt_bytes(PNG, rng)), 300),
    Door("read_color", lambda rng: color(spoilt_bytes(rng.choice([PNG, JPEG]), rng)), 300),
    Door("read_camera", lambda rng: camera(spoilt_value(CAMERA, rng)), 300),
]
CASES = [
    Case("an image for locate_all as it should be", lambda: several(None), None),
    Case(
        "detections as they should be",
        lambda: hints("detections", json.dumps(FOUND).encode(), good=True),
        None,
    ),
    Case(
        "targets as they should be", lambda: hints("targets", json.dumps(TARGETS).encode(), good=True), None
    ),
    Case("poses as they should be", lambda: hints("start", POSES.encode(), good=True), None),
    Case("depth as it should be", lambda: depth(PNG), None),
    Case("colour as it should be", lambda: color(JPEG), None),
    Case("a camera as it should be", lambda: camera(CAMERA), None),
    Case("a BOP folder as it should be", lambda: bop_folder(None), None),
    Case("a BOP scene as it should be", lambda: scene(SCENE), None),
    Case("a BOP scene without images", lambda: scene({}), "expected a camera for each image, got none"),
    Case(
        "a PNG of the first 10 of 24 rows",
        lambda: depth(rows(PNG, 10)),
        "expected a complete PNG, got 650 bytes of",
    ),
    Case(
        "a PNG that ends in black",
        lambda: depth(image(STEPS * (np.arange(24) < 10)[:, None].astype(np.uint16))),
        None,
    ),
    Case("a camera's middle 1e300 away", lambda: camera({**CAMERA, "cx": 1e300}), "cx, cy within 1e+06, got"),
    Case("a focal length of 1e-300", lambda: camera({**CAMERA, "fx": 1e-300}), "fx, fy from 0.01 to 1e+06"),
    Case(
        "a lens of 1e308",
        lambda: camera({**CAMERA, "lens": [1e308] * 8}),
        "lens: expected numbers within 10000",
    ),
    Case("masked depth", masked, "depth: expected numbers, got a masked array"),
    Case(
        "depth of 8 bits",
        lambda: depth(image(STEPS.astype(np.uint8))),
        "a: expected a PNG of 16 bits for depth",
    ),
    Case("a JPEG for depth", lambda: depth(JPEG), "a: expected a PNG of 16 bits for depth, got mode RGB"),
]
