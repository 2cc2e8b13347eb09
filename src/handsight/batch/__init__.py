"""Batches of problems: read from JSON lines, solved by processes of this machine or by a cluster."""
