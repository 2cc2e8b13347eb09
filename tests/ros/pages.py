"""The page of a node, as somebody without a browser looks at it."""

import re
import socket
import urllib.error
import urllib.request


def free_port():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        return held.getsockname()[1]


def served(process):
    """Where a node that is ready said that its page is, and there it is."""
    found = re.search(r"look at (http://127\.0\.0\.1:\d+/\?token=[\w-]+)", process.log.read_text())
    assert found, process.log.read_text()
    with urllib.request.urlopen(found[1], timeout=60) as page:
        assert b"<html" in page.read(4096)
    return found[1]


def gone(address):
    try:
        with urllib.request.urlopen(address, timeout=60):
            return False
    except (urllib.error.URLError, ConnectionError):
        return True
