"""Images in all encodings become red, green, blue and metres; what is no image is counted, never raised."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from messages.ros import START, Messages, heard, rig, touched

M = Messages()
RNG = np.random.default_rng(0)
COLOR = RNG.integers(0, 255, (6, 5, 3), dtype=np.uint8)
DEPTH_MM = RNG.integers(300, 2000, (6, 5)).astype("<u2")
DEPTH_MM[2, 3] = 0
DEPTH = np.where(DEPTH_MM > 0, DEPTH_MM / 1000, np.nan).astype("<f4")


def with_images(*messages):
    """Observations that have an image, and the report."""
    rows = touched(50)
    rows += [(topic, START + 0.105, message) for topic, message in messages]
    observations, stream = heard(sorted(rows, key=lambda row: row[1]))
    assert len(observations) == 50
    return [s for s in observations if s.color is not None or s.depth is not None], stream.report


def file_of(pixels, kind="PNG"):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    return stream.getvalue()


def padded(pixels, extra):
    """Rows with bytes behind them, and their step."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    rows = np.hstack([rows, np.full((len(rows), extra), 77, np.uint8)])
    return rows.ravel(), rows.shape[1]


def stamp():
    return START + 0.105


@pytest.mark.parametrize("extra", [0, 7])
@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_colour_is_red_green_blue(encoding, extra):
    data, step = padded(COLOR if encoding == "rgb8" else np.ascontiguousarray(COLOR[..., ::-1]), extra)
    (seen,), _ = with_images(("/color", M.image(stamp(), COLOR, encoding, data=data, step=step)))
    np.testing.assert_array_equal(seen.color, COLOR)
    assert seen.color.dtype == np.uint8


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("extra", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixels"), [("16UC1", DEPTH_MM), ("mono16", DEPTH_MM), ("32FC1", DEPTH)]
)
def test_depth_is_in_metres_with_nan_where_there_is_none(encoding, pixels, big, extra):
    data, step = padded(pixels.byteswap() if big else pixels, extra)
    message = M.image(stamp(), pixels, encoding, data=data, step=step, big=big)
    (seen,), report = with_images(("/depth", message))
    np.testing.assert_allclose(seen.depth, DEPTH, atol=1e-6)
    assert seen.depth.dtype == np.float32
    assert report.topics["/depth"].used == 1


def test_what_is_not_a_distance_is_nan():
    pixels = np.array([[1.0, 0.0, -1.0, np.inf, -np.inf, np.nan]], "<f4")
    (seen,), _ = with_images(("/depth", M.image(stamp(), pixels, "32FC1")))
    np.testing.assert_array_equal(seen.depth, [[1.0] + [np.nan] * 5])


def test_an_image_without_any_depth_is_one():
    (seen,), _ = with_images(("/depth", M.image(stamp(), np.zeros((3, 4), "<u2"), "16UC1")))
    assert np.isnan(seen.depth).all()


def test_compressed_colour():
    (seen,), _ = with_images(("/color", M.compressed(stamp(), file_of(COLOR), "rgb8; png compressed bgr8")))
    np.testing.assert_array_equal(seen.color, COLOR)
    smooth = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    (seen,), _ = with_images(("/color", M.compressed(stamp(), file_of(smooth, "JPEG"), "jpeg")))
    np.testing.assert_allclose(seen.color.astype(int), smooth, atol=3)


def test_compressed_depth():
    png = file_of(DEPTH_MM)
    (seen,), _ = with_images(("/depth", M.compressed(stamp(), png, "16UC1; png")))
    np.testing.assert_allclose(seen.depth, DEPTH, atol=1e-6)
    header = struct.pack("<iff", 0, 0, 0)
    (seen,), _ = with_images(("/depth", M.compressed(stamp(), header + png, "16UC1; compressedDepth png")))
    np.testing.assert_allclose(seen.depth, DEPTH, atol=1e-6)


def test_compressed_depth_of_floats_is_the_inverse_of_what_was_stored():
    """depth = A / (value - B), as compressed_depth_image_transport quantises it."""
    a, b = 1000.0, -50.0
    values = np.where(DEPTH_MM > 0, np.round(a / np.nan_to_num(DEPTH, nan=1.0) + b), 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + file_of(values)
    (seen,), _ = with_images(("/depth", M.compressed(stamp(), data, "32FC1; compressedDepth png")))
    np.testing.assert_allclose(seen.depth, DEPTH, rtol=2e-3)


def huge_png():
    """A PNG that says it is 60 000 pixels wide and high, in a few bytes."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(100)))
        + chunk(b"IEND", b"")
    )


DEPTH_IN_MM = M.image(START, (DEPTH * 1000).astype("<f4"), "32FC1")
TWO_MM = M.image(START, np.full((6, 5), 2, "<u2"), "16UC1")
SHORT = M.image(START, COLOR, "rgb8", data=np.zeros(50, np.uint8), step=15)


@pytest.mark.parametrize(
    ("topic", "message", "said"),
    [
        ("/depth", DEPTH_IN_MM, "metres (32FC1)"),
        ("/depth", TWO_MM, "millimetres (16UC1)"),
        ("/depth", M.image(START, COLOR, "rgb8"), "'rgb8'"),
        ("/color", M.image(START, DEPTH_MM, "16UC1"), "'16UC1'"),
        ("/color", SHORT, "50 bytes"),
        ("/color", M.image(START, COLOR, "rgb8", step=14), "90 bytes"),
        ("/color", M.compressed(START, b"nothing", "jpeg"), "PNG or JPEG"),
        ("/color", M.compressed(START, file_of(COLOR)[:60], "png"), "PNG or JPEG"),
        ("/color", M.compressed(START, file_of(COLOR, "BMP"), "bmp"), "PNG or JPEG"),
        ("/color", M.compressed(START, huge_png(), "png"), "expected"),
        ("/depth", M.compressed(START, file_of(COLOR), "png"), "RGB"),
        ("/depth", M.compressed(START, b"12", "16UC1; compressedDepth png"), "2 bytes"),
        ("/depth", M.compressed(START, b"12", "16UC1; compressedDepth rvl"), "RVL"),
    ],
)
def test_an_image_that_cannot_be_used_is_counted_with_the_reason(topic, message, said):
    observations, report = with_images((topic, message))
    assert observations == []
    assert (report.topics[topic].bad, report.topics[topic].used) == (1, 0)
    (reason,) = report.topics[topic].reasons
    assert said in reason


def test_the_newest_of_several_images_is_taken():
    rows = touched(20, rate=10.0)
    rows += [
        ("/color", START + i / 30, M.image(START + i / 30, np.full((2, 2, 3), i, np.uint8), "rgb8"))
        for i in range(30)
    ]
    observations, _ = heard(sorted(rows, key=lambda row: row[1]), rig())
    shown = [int(seen.color[0, 0, 0]) for seen in observations[:10] if seen.color is not None]
    assert shown == [3 * i for i in range(10)]
