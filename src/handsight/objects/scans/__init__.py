"""Noisy points: their noise, the surface behind them, and how far that may be off the object."""
