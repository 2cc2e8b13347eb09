"""DDS types of ROS 2 messages: they describe every field to other participants, but carry serialised bytes."""

from functools import cache
from types import new_class
from typing import Any, Self

from cyclonedds import idl
from cyclonedds.idl import types

from handsight.errors import InvalidInput
from handsight.messages.decode import rosbags_module, typestore


class Sample:
    """A `Sample` is a serialised message that a reader takes or a writer writes; it is not decoded."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, *_: object, **__: object) -> bytes:
        """Returns the bytes."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, /, *_: object, **__: object) -> Self:
        """Returns the message of these bytes."""
        return cls(data)

    deserialize_key = deserialize


def dds_name(kind: str) -> str:
    """Returns the DDS name of the ROS 2 type `package/msg/Name`."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Returns `package/msg/Name` for the DDS name of a ROS 2 type; any other name is returned unchanged."""
    parts = dds.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return dds


@cache
def message_type(kind: str) -> Any:
    """Returns the DDS class for messages of the ROS 2 type `package/msg/Name`.

    Its fields only describe the type to other participants, which may compare it with their own before they connect.
    Raises InvalidInput, MissingExtra.
    """
    known = typestore("cdr").fielddefs
    if kind not in known:
        raise InvalidInput(f"expected a message of ROS 2 that is known here, got {kind}")
    fields = {name: _field(node) for name, node in known[kind][1]}

    def fill(namespace: dict[str, Any]) -> None:
        namespace.setdefault("__annotations__", {}).update(fields)
        methods = ("__init__", "serialize", "deserialize", "deserialize_key")
        namespace.update({name: vars(Sample)[name] for name in methods})

    # A plain `type(...)` call would lose the `typename` for the metaclass.
    name = kind.rsplit("/", 1)[1]
    return new_class(name, (idl.IdlStruct,), {"typename": dds_name(kind).replace("::", ".")}, fill)


def _field(node: Any) -> Any:
    """Returns the DDS type of a field, from the description in rosbags."""
    nodes = rosbags_module("rosbags.interfaces").Nodetype
    kind, what = node
    if kind == nodes.NAME:
        return message_type(what)
    if kind == nodes.BASE:
        own = {"bool": bool, "string": str, "octet": types.byte, "byte": types.byte, "char": types.uint8}
        return own.get(what[0]) or getattr(types, what[0])
    element, count = what
    if kind == nodes.ARRAY:
        return types.array[_field(element), count]
    return types.sequence[_field(element), count] if count else types.sequence[_field(element)]
