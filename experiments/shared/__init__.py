"""What several experiments share: simulated trials, methods and their errors; and the names of `testbed`, the room that
benchmarks share with them, which lies beside this folder."""

import sys
from pathlib import Path

# An experiment is run as a file, and Python then looks for modules in its folder alone.
sys.path.append(str(Path(__file__).parents[2]))

from testbed import figures as figures
from testbed import gel_scenes as gel_scenes
from testbed import hand_scenes as hand_scenes
from testbed import many_scenes as many_scenes
from testbed import pad_scenes as pad_scenes
from testbed import report as report
from testbed import scenes as scenes
from testbed import sight as sight
from testbed import sight_scenes as sight_scenes
from testbed import skin_scenes as skin_scenes
from testbed import tip_scenes as tip_scenes
from testbed import ycb as ycb
