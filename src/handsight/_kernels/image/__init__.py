"""Depth images: rendering, first poses by votes, and poses refined and scored against pixels."""
