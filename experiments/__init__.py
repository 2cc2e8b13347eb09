"""What the manual's tables and figures are made by: `python -m experiments.ROOM.NAME`."""
