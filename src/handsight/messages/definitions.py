"""Types of messages that rosbags does not know, and which of them have contacts or taxels.

Their definitions, in `data/messages`, are as the drivers state them: sr_robot_msgs of the Shadow Robot Company,
tactile_msgs of ubi-agni/tactile_toolbox, its_msgs, xela_server_ros2 of mcsix, inspire_hand_ros2 of
laurent-19/inspire_hand_ws, and vision_msgs. A recording's own come first.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

MESSAGES = Path(__file__).parents[1] / "data" / "messages"
SHADOW = "sr_robot_msgs/msg/ShadowContactStateStamped"
TACTILE = "tactile_msgs/msg/TactileContact"
ITS = "its_msgs/msg/SoftContactSensingProblemSolution"
CONTACTS = SHADOW, TACTILE, f"{TACTILE}s", ITS  # types that say where a fingertip is touched
NUMBERS = "Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32"
PLAIN_TAXELS = (
    *(f"std_msgs/msg/{number}MultiArray" for number in NUMBERS),
    *(f"std_msgs/msg/{number}" for number in ("Bool", *NUMBERS)),
    *("sensor_msgs/msg/Image", "sensor_msgs/msg/ChannelFloat32", "tactile_msgs/msg/TactileState"),
)
"""Types with readings of taxels that are found without a path into the message; of a TactileState by the name."""
TAXELS = (
    *PLAIN_TAXELS,
    "sensor_msgs/msg/PointCloud2",
    "xela_server_ros2/msg/SensStream",
    "xela_server_ros/msg/SensStream",
    "inspire_hand_ros2/msg/InspireHandTouch",
)
"""Types with readings of taxels that are known without a definition from the recording."""


@cache
def definitions(folder: str) -> dict[str, str]:
    """Returns definitions by name: those of a folder `cdr`, `ros1`, or `both` for either encoding.

    Live messages bring none, but over ROS 1.
    """
    files = MESSAGES.glob(f"{folder}/*/*.msg")
    return {f"{file.parent.name}/msg/{file.stem}": file.read_text("utf-8") for file in files}


NESTED = re.compile(r"^\s*(?:(\w+)/(?:msg/)?)?([A-Z]\w*)(?:\[[^\]]*\])?\s+\w", re.MULTILINE)
"""A line of a definition with a field that is a message: its package, if it is another one, and its name."""
SEPARATOR = "=" * 80


@cache
def definitions_in(folders: tuple[str, ...]) -> dict[str, str]:
    """Returns by type the definition in each `.msg` file of packages' folders, such as `their_msgs/msg`.

    As recorders write it, those that it is made of are behind it, as far as the folders have them. Raises OSError,
    UnicodeDecodeError.
    """
    files = [file for folder in folders for file in sorted(Path(folder).glob("*.msg"))]
    texts = {f"{file.parent.parent.name}/msg/{file.stem}": file.read_text("utf-8") for file in files}
    found = dict[str, str]()
    for kind in texts:
        parts = [f"{SEPARATOR}\nMSG: {each}\n{texts[each]}" for each in _parts_of(kind, texts)]
        found[kind] = "\n".join([texts[kind], *parts])
    return found


def _parts_of(kind: str, texts: Mapping[str, str]) -> list[str]:
    """Returns the types of messages within a type's, and within these, as far as they are known."""
    found = [kind]
    for each in found:  # which grows meanwhile
        found += [part for part in _nested(each, texts) if part not in found]
    return found[1:]


def _nested(kind: str, texts: Mapping[str, str]) -> Iterator[str]:
    """Yields the known types of a type's own fields, each once."""
    package = kind.partition("/")[0]
    fields = NESTED.findall(texts[kind])
    yield from dict.fromkeys(name for p, n in fields if (name := f"{p or package}/msg/{n}") in texts)
