"""handsight against its peers: time, success and accuracy side by side. Run with `python -m benchmarks`."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# The problems, tables and figures are the experiments', so that both speak of the same thing.
if str(ROOT / "experiments") not in sys.path:
    sys.path.append(str(ROOT / "experiments"))
