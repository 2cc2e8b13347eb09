"""The simulation's tables: objects, the Shadow hand's tips, grasps, motions, and sizes of errors."""

from functools import cache
from pathlib import Path
from typing import Any

from handsight.errors import needing

FILE = Path(__file__).parents[1] / "data/simulation.yaml"


@cache
def tables() -> dict[str, Any]:
    """Returns all tables by name, as the file has them; raises MissingExtra."""
    with needing("simulation needs ruamel.yaml", "sim"):
        from ruamel.yaml import YAML
    return dict(YAML(typ="safe").load(FILE))
