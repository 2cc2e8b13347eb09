"""What DDS is told of ROS 2's messages, and where they are looked for."""

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")

from handsight.bridge.bridge import carried
from handsight.bridge.message_types import dds_name, message_type, ros_name
from handsight.bridge.network import FAST_DDS_3, LOOPBACK, configuration, domain_id
from handsight.errors import InvalidInput
from handsight.messages.topics import (
    COMPRESSED,
    CONTACT,
    IMAGE,
    INFO,
    JOINTS,
    POSE,
    POSE_COVARIANCE,
    TF,
    WRENCH,
)


@pytest.mark.parametrize(
    "kind", [COMPRESSED, CONTACT, IMAGE, INFO, JOINTS, POSE, POSE_COVARIANCE, TF, WRENCH]
)
def test_every_type_that_a_rig_may_hear_is_one_of_dds_and_keeps_its_bytes(kind):
    made = message_type(kind)
    made.__idl__.populate()
    made.__idl__.fill_type_data()
    assert made.__idl_typename__.replace(".", "::") == dds_name(kind)
    assert ros_name(dds_name(kind)) == kind
    for received in (made.deserialize(b"bytes", has_header=True), made.deserialize_key(b"bytes")):
        assert received.data == received.serialize(use_version_2=False) == b"bytes"
    assert message_type(kind) is made


def test_types_of_others_keep_their_names_and_unknown_ones_are_refused():
    assert ros_name("company::Thing") == "company::Thing"
    with pytest.raises(InvalidInput, match="known here, got tf/msg/tfMessage"):
        message_type("tf/msg/tfMessage")


def test_topics_are_called_as_ros_2_calls_them():
    assert carried("/joint_states") == carried("joint_states") == "rt/joint_states"


def test_the_users_configuration_comes_last_and_counts():
    assert configuration({}) == FAST_DDS_3
    assert configuration({"CYCLONEDDS_URI": "file:///x.xml,"}) == f"{FAST_DDS_3},file:///x.xml"
    for alone in ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}):
        assert configuration(alone) == f"{FAST_DDS_3},{LOOPBACK}"
    assert configuration({"ROS_LOCALHOST_ONLY": "0"}) == FAST_DDS_3


def test_the_domain_is_the_environments():
    assert domain_id({}) == domain_id({"ROS_DOMAIN_ID": ""}) == 0
    assert domain_id({"ROS_DOMAIN_ID": " 42 "}) == 42
    for wrong in ("-1", "233", "a", "4.5", "²", "9" * 30):
        with pytest.raises(InvalidInput, match="ROS_DOMAIN_ID: expected a number from 0 to 232, got"):
            domain_id({"ROS_DOMAIN_ID": wrong})
