"""The readers of what comes hundreds of times a second, for each encoding; they remember from message to message."""

from handsight.messages.fast_cdr import FastCdrReader
from handsight.messages.fast_ros1 import FastRos1Reader


class FastReaders(dict[str, FastCdrReader | FastRos1Reader]):
    """By encoding."""

    def __init__(self) -> None:
        super().__init__(cdr=FastCdrReader(), ros1=FastRos1Reader())
