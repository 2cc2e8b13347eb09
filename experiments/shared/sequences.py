"""Sequences of depth images: the tests' (tests/sight_sequences.py)."""

import sight_sequences as drawn

__all__ = ["drawn"]
