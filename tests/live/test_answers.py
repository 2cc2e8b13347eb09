"""What is written hundreds of times a second is what rosbags writes."""

from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.errors import InvalidInput
from handsight.live.answers import Writer, pose_numbers
from handsight.messages.encode import header, pose
from handsight.messages.topics import OwnTopic, RosType

STAMPS = st.floats(0, 2.0**31 - 1)
SMALL = st.floats(-3, 3)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@given(
    STAMPS, st.lists(SMALL, min_size=6, max_size=6), st.sampled_from(["palm", "rh_palm", "hand/a palm", ""])
)
def test_poses_and_transforms_are_what_rosbags_writes(encoding, stamp, six, palm):
    writer, T = Writer(encoding, palm), se3.moved(np.eye(4), np.array(six))
    covariance = np.diag(np.arange(1.0, 7)) + 0.1
    estimate, numbers = Message(bounded_covariance=covariance), pose_numbers(T)
    body, top = pose(T), header(stamp, palm)
    expected = writer.answer(
        OwnTopic.POSE,
        RosType.POSE_COVARIANCE,
        header=top,
        pose=Message(pose=body, covariance=covariance.ravel()),
    )
    assert writer.pose(stamp, estimate, numbers) == expected
    link = Message(translation=body.position, rotation=body.orientation)
    expected = writer.answer(
        "/tf", RosType.TF, transforms=[Message(header=top, child_frame_id="object", transform=link)]
    )
    assert writer.transform(stamp, numbers) == expected


def test_a_stamp_that_a_message_cannot_hold_is_refused():
    writer = Writer("cdr", "palm")
    with pytest.raises(InvalidInput, match="stamp: expected seconds from 0 to"):
        writer.transform(2.0**31, pose_numbers(np.eye(4)))
