"""Tactile arrays are heard as arrays and as images, from ROS 1 as from ROS 2, and what is none is told."""

from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest

from handsight.contact import TactileSurface
from handsight.messages import ObservationStream, RawMessage, RosType
from handsight.messages.encode import header, taxel_fields
from handsight.messages.read import typestore
from messages.ros import START, Messages, raw, rig

M = Messages()
TAXELS = TactileSurface.grid(
    frame="palm", T_frame_grid=np.eye(4), rows=2, columns=3, pitch=0.004, threshold=0.1
)
READING = np.arange(6.0).reshape(2, 3)


def robot():
    listening = rig(skin={"palm": "/skin"})
    listening.hand.chains_to = lambda links: None
    return replace(listening, skin={"palm": TAXELS})


def said(message, kind=RosType.ARRAY, encoding="cdr"):
    data = getattr(typestore(encoding), f"serialize_{encoding}")(Message(**message), kind)
    return RawMessage("/skin", kind, encoding, START, bytes(data))


def image(pixels, encoding):
    top, height, width = header(START), *pixels.shape
    data = np.frombuffer(pixels.tobytes(), dtype=np.uint8)
    layout = {"is_bigendian": 0, "step": len(data) // height, "data": data}
    return {"header": top, "height": height, "width": width, "encoding": encoding, **layout}


def heard(message):
    stream = ObservationStream(robot())
    found = list(stream.put(raw("/joint_states", START, M.joints(START))))
    found += [*stream.put(message), *stream.finish()]
    return found, stream.report.topics["/skin"]


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_an_array_is_in_the_observation_at_the_time_it_was_logged(encoding):
    observations, topic = heard(said(taxel_fields(READING, TAXELS, "palm"), encoding=encoding))
    np.testing.assert_array_equal(observations[0].skin["palm"], READING)
    assert (topic.used, topic.unstamped) == (1, True)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(
    ("name", "kind"), [("mono8", "u1"), ("8UC1", "u1"), ("mono16", "u2"), ("16UC1", "u2"), ("32FC1", "f4")]
)
def test_an_image_is_one_too(name, kind, encoding):
    observations, _ = heard(said(image(READING.astype(kind), name), RosType.IMAGE, encoding))
    np.testing.assert_array_equal(observations[0].skin["palm"], READING)


def test_a_flat_array_is_in_the_rows_of_the_grid_and_a_dead_taxel_is_nan():
    data = np.array([9, 0, 1, np.nan, 3, np.inf, 5], np.float32)
    observations, _ = heard(said({"layout": Message(dim=[], data_offset=1), "data": data}))
    np.testing.assert_array_equal(observations[0].skin["palm"], [[0, 1, np.nan], [3, np.nan, 5]])


@pytest.mark.parametrize(
    ("values", "sizes", "reason"),
    [
        (np.zeros(5), [], "expected 2 x 3 taxels, got 5 numbers"),
        (np.zeros(6), [3, 2], "expected 2 x 3 taxels, got 3 x 2"),
        (np.full(6, np.nan), [2, 3], "no taxel has a finite reading"),
    ],
)
def test_readings_of_another_array_are_left_out_and_reported(values, sizes, reason):
    dim = [Message(label="", size=size, stride=0) for size in sizes]
    message = {"layout": Message(dim=dim, data_offset=0), "data": values.astype(np.float32)}
    observations, topic = heard(said(message))
    assert not observations[0].skin
    assert list(topic.reasons) == [f"skin palm: {reason}"]


def test_colour_is_no_reading():
    pixels = np.zeros((2, 9), np.uint8)
    observations, topic = heard(said({**image(pixels, "rgb8"), "width": 3}, RosType.IMAGE))
    assert not observations[0].skin
    assert "expected encoding mono8, 8UC1" in next(iter(topic.reasons))
