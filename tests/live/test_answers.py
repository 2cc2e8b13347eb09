"""What is published says what the tracker knows, in either encoding."""

from types import SimpleNamespace

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput
from handsight.live.answers import Writer
from testbed.refusals import refused
from tests.live.recorded import read


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_poses_and_transforms_are_the_estimate_s(encoding):
    writer, T = Writer(encoding, "rh_palm"), se3.random(np.random.default_rng(0))
    covariance = np.diag(np.arange(1.0, 7)) + 0.1
    estimate = SimpleNamespace(T_palm_object=T, bounded_covariance=covariance)
    posed = read(writer.pose(1.7e9 + 0.25, estimate), encoding)
    link = read(writer.transform(1.7e9 + 0.25, T), encoding).transforms[0]
    np.testing.assert_array_equal(posed.pose.covariance.reshape(6, 6), covariance)
    assert (
        (link.header.frame_id, link.child_frame_id)
        == (posed.header.frame_id, "object")
        == ("rh_palm", "object")
    )
    for stamp in (posed.header.stamp, link.header.stamp):
        assert (stamp.sec, stamp.nanosec) == (1_700_000_000, 250_000_000)
    at = (posed.pose.pose.position, posed.pose.pose.orientation)
    for p, q in (at, (link.transform.translation, link.transform.rotation)):
        np.testing.assert_array_equal([p.x, p.y, p.z], T[:3, 3])
        np.testing.assert_array_equal([q.x, q.y, q.z, q.w], se3.quaternion_from_rotation(T[:3, :3]))


def test_a_stamp_that_a_message_cannot_hold_is_refused():
    with refused(InvalidInput, "stamp"):
        Writer("cdr", "palm").transform(2.0**31, np.eye(4))
