"""The DDS domain of the ROS 2 nodes, joined as ROS 2's environment variables specify."""

import os
from collections.abc import Mapping
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant

from handsight import checks
from handsight.errors import InvalidInput

FAST_DDS_3 = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
"""Turns type comparison off with Fast DDS 3 (ROS 2 Kilted), whose descriptions of equal types may differ."""
LOOPBACK = (
    '<General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
)
"""Restricts communication to this machine, as ROS 2 does for LOCALHOST."""


def domain_id(environment: Mapping[str, str]) -> int:
    """Returns ROS_DOMAIN_ID, or 0 if it is not set; raises InvalidInput."""
    declared, largest = environment.get("ROS_DOMAIN_ID", "").strip() or "0", 232
    if not (declared.isascii() and declared.isdigit() and int(declared[:9]) <= largest):
        came = checks.brief(repr(declared))
        raise InvalidInput(f"ROS_DOMAIN_ID: expected a number from 0 to {largest}, got {came}")
    return int(declared)


def configuration(environment: Mapping[str, str]) -> str:
    """Returns Cyclone DDS' configuration: that for Fast DDS 3, for LOCALHOST if ROS 2 is set so, and the user's own."""
    alone = (
        environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or environment.get("ROS_LOCALHOST_ONLY") == "1"
    )
    # Later parts override earlier ones.
    parts = FAST_DDS_3, LOOPBACK if alone else "", environment.get("CYCLONEDDS_URI", "").strip(", ")
    return ",".join(part for part in parts if part)


class Network:
    """A `Network` is a participant in a DDS domain; a process can have one for each domain."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """Joins the domain; raises InvalidInput where its number or the configuration does not allow that."""
        number, config = domain_id(environment), configuration(environment)
        try:
            self._domain: Any = Domain(number, config)
            self.participant: Any = DomainParticipant(number)
        except (DDSException, UnicodeEncodeError) as error:
            of = "CYCLONEDDS_URI and the network"
            raise InvalidInput(f"domain {number}: expected {of} to let it be joined, got: {error}") from None
