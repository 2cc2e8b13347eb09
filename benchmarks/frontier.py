"""Which settings a peer is compared with.

They were chosen on another seed than the reported one: of each peer's grid the fastest setting whose success is within
.02 of the best, for each object and each error of vision.
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.workload import Peer

FILE = Path(__file__).with_name("frontier.json")
Row = dict[str, Any]


def case_name(object_name: str, error: str) -> str:
    """Returns the key of one table."""
    return f"{object_name}, {error}"


def stored(path: Path = FILE) -> Row:
    """Returns the settings that a full run has chosen; none where there is no such file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"peers": {}}


def tuned(key: str, peer: Any, object_name: str, error: str, frontier: Row) -> tuple[Peer, Row | None]:
    """Returns the peer with the setting chosen for this case, if one was, and that setting."""
    entry = frontier["peers"].get(key, {}).get(case_name(object_name, error))
    if entry is None:
        return peer, None
    return peer.using(entry["chosen"]["setting"]), entry["chosen"]["setting"]
