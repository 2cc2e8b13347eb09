"""The compiled inner loops. Flat arrays in, flat arrays out; nothing is checked and nothing is explained here.

Each kernel names its twin: the plain NumPy code, in the room it serves, that says what it means and that the
tests hold it to. Importing this package costs numba's import, so the rooms do it at their first call.
"""
