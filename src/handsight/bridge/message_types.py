"""Messages of ROS 2 as types of DDS: described to the others field by field, but handed over as the bytes they are."""

from functools import cache
from types import new_class
from typing import Any, Protocol

from cyclonedds import idl
from cyclonedds.idl import types

from handsight.errors import InvalidInput
from handsight.messages.decode import rosbags_module, typestore


class Sample(Protocol):
    """A `Sample` is what a reader takes and a writer writes."""

    data: bytes


def dds_name(kind: str) -> str:
    """Returns what ROS 2 calls the type `package/msg/Name` on DDS."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Returns `package/msg/Name` of a type on DDS; of one that is not ROS 2's, its own name."""
    parts = dds.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return dds


@cache
def message_type(kind: str) -> Any:
    """Returns the class of DDS for messages of that type, `package/msg/Name`: made of bytes, `data` are they again.

    The fields serve others alone, which may compare them with their own before they talk. Raises InvalidInput,
    MissingExtra.
    """
    known = typestore("cdr").fielddefs
    if kind not in known:
        raise InvalidInput(f"expected a message of ROS 2 that is known here, got {kind}")
    fields = {name: _field(node) for name, node in known[kind][1]}

    def fill(namespace: dict[str, Any]) -> None:
        namespace.setdefault("__annotations__", {}).update(fields)
        decode = classmethod(_from_bytes)
        namespace.update(__init__=_keep, serialize=_bytes, deserialize=decode, deserialize_key=decode)

    # A plain `type(...)` call would lose the name that the metaclass is given.
    return new_class(
        kind.rsplit("/", 1)[1], (idl.IdlStruct,), {"typename": dds_name(kind).replace("::", ".")}, fill
    )


def _field(node: Any) -> Any:
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


def _keep(self: Sample, data: bytes) -> None:
    self.data = data


def _bytes(self: Sample, *_: object, **__: object) -> bytes:
    return self.data


def _from_bytes(cls: type[Any], data: bytes, /, *_: object, **__: object) -> Any:
    return cls(data)
