"""The room that experiments and benchmarks share: problems with known answers, how answers are judged, tables, figures.

Synthetic problems are the tests' (`tests/scenes.py` and its neighbours): what is published was found on what is tested.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))

import gel_scenes as gel_scenes
import hand_scenes as hand_scenes
import many_scenes as many_scenes
import pad_scenes as pad_scenes
import scenes as scenes
import sight_scenes as sight_scenes
import sight_sequences as sight_sequences
import skin_scenes as skin_scenes
import tip_scenes as tip_scenes
import views_around as views_around
