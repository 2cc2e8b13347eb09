"""The path from a message to a tactile surface's readings, such as `sensors[sensor_pos=3].forces[0:30]`."""

import re

from handsight import checks
from handsight.errors import InvalidInput

STEP = re.compile(
    r"\.?(?P<name>[A-Za-z]\w*)"
    r"|\[(?P<index>\d{1,6})\]"
    r"|\[(?P<first>\d{0,6}):(?P<end>\d{0,6})\]"
    r"|\[(?P<key>[A-Za-z]\w*)=(?P<value>[^\[\]=]+)\]"
    r"|\[(?P<columns>[A-Za-z]\w*(?:,[A-Za-z]\w*)*)\]"
)
"""A step into a message. `data` is a field; `data[3]` its fourth element, `data[0:9]` nine of them;
`sensors[name=thumb]` the element whose `name` is thumb; `taxels[x,y,z]` three numbers of each element, or of each point
of a PointCloud2."""


def steps(field: str) -> list[re.Match[str]]:
    """Returns the steps of a path into a message; raises InvalidInput for a text that is none."""
    found, at = list[re.Match[str]](), 0
    while step := STEP.match(field, at):
        found, at = [*found, step], step.end()
    if at < len(field) or not 0 < len(field) <= 200:
        example = "such as sensors[sensor_pos=3].forces[0:30] or [fx,fy,fz]"
        raise InvalidInput(f"expected a path into a message, {example}, got {checks.brief(field)}")
    return found
