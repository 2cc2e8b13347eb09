"""Deprecated: this room is now `handsight.search`."""

from handsight import search
from handsight._deprecated import renamed

__getattr__ = renamed(__name__, {name: f"handsight.search.{name}" for name in search.__all__})
