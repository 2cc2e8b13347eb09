"""Many problems: read from JSON lines, answered by processes of this machine or by a cluster."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from handsight.batch.run import answering

__all__ = ["answering"]


def __getattr__(name: str) -> object:
    """Returns `answering`, imported at its first use: the room's other modules need nothing of it."""
    if name != "answering":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from handsight.batch.run import answering

    return answering
