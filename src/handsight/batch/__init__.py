"""Many problems: read from JSON lines, answered by processes of this machine or by a cluster."""

from handsight.batch.run import answering

__all__ = ["answering"]
