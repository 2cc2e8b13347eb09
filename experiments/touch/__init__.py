"""Corrections by touch, on synthetic problems."""
