"""The command `handsight`: parse, call, print."""

from handsight.cli.main import main

__all__ = ["main"]
