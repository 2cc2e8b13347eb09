"""Fingertips that sense contacts themselves are heard, from ROS 1 as from ROS 2."""

import numpy as np
import pytest

from handsight.messages import ObservationStream, RawMessage, RosType
from handsight.messages.encode import Message, header, parts
from handsight.messages.read import typestore
from messages.ros import START, Messages, raw, rig

M = Messages()
NORMAL = np.array([0.0, 0.6, -0.8])


def robot():
    return rig(wrenches={"ff": "/ff/wrench"}, contacts={"th": "/th/contact"})


def said(stamp, frame="", force=1.0, point=(0.001, 0.002, 0.003), normal=NORMAL, encoding="cdr"):
    message = Message(
        header=header(stamp, frame),
        tangential_force=parts("xyz", np.zeros(3)),
        contact_position=parts("xyz", np.array(point)),
        contact_normal=parts("xyz", np.array(normal)),
        f_normal=force,
        l_torque=0.0,
    )
    data = getattr(typestore(encoding), f"serialize_{encoding}")(message, RosType.CONTACT)
    return RawMessage("/th/contact", RosType.CONTACT, encoding, stamp, bytes(data))


def heard(*contacts):
    stream = ObservationStream(robot())
    found = []
    for contact in contacts:
        found += stream.put(raw("/joint_states", contact.log_time, M.joints(contact.log_time)))
        found += stream.put(contact)
    return found + stream.finish(), stream


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(("named", "frame"), [("", "tip"), ("th", "th"), ("/palm", "palm")])
def test_a_contact_is_in_the_observation_in_its_frame(encoding, named, frame):
    observations, stream = heard(said(START, named, force=2.5, encoding=encoding))
    contact = observations[0].contacts["th"]
    assert (contact.frame, contact.force) == (frame, 2.5)
    np.testing.assert_array_equal(contact.point, [0.001, 0.002, 0.003])
    np.testing.assert_allclose(contact.normal, NORMAL, atol=1e-15)
    assert stream.report.topics["/th/contact"].used == 1


@pytest.mark.parametrize("nothing", [{"force": 0.0}, {"normal": np.zeros(3)}])
def test_a_tip_that_touches_nothing_has_no_contact(nothing):
    observations, _ = heard(said(START, **nothing))
    assert observations[0].contacts == {"th": None}


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"frame": "moon"}, "unknown frame 'moon'; valid: none (the tip's own), 'th', 'palm'"),
        ({"point": (np.nan, 0, 0)}, "position, normal or force is not finite"),
        ({"point": (1e9, 0, 0)}, "contact.point: expected"),
    ],
)
def test_what_cannot_be_a_contact_is_left_out_and_named(wrong, expected):
    observations, stream = heard(said(START, **wrong))
    assert observations[0].contacts == {}
    assert any(
        "/th/contact: 1 of 1 messages left out: " + expected in each for each in stream.report.sentences()
    )
