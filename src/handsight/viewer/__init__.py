"""Pictures of corrections and of tracked recordings, and a page that shows a tracker or a recording at work.

Pictures need matplotlib, the page needs viser: each is imported when one is drawn. The names below are loaded when
one of them is first used, because a picture needs no tracker.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handsight.viewer.live_viewer import Viewer, view

__all__ = ["Viewer", "view"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("handsight.viewer.live_viewer"), name)
