"""Many problems: read from JSON lines, answered by processes of this machine or by a cluster."""
