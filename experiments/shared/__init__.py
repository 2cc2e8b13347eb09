"""What the experiments share: problems and trials, how errors are measured, tables, figures."""

import sys
from pathlib import Path

# The problems are the tests' (tests/scenes.py): what is published was found on what is tested.
sys.path.append(str(Path(__file__).parents[2] / "tests"))

import hand_scenes as hand_scenes
import scenes as scenes
import sight_scenes as sight_scenes
import skin_scenes as skin_scenes
