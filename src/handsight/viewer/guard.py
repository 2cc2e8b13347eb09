"""Who may read a page: a browser that was given its address, and no other site's page that is open in that browser."""

import contextlib
import re
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from handsight.errors import HandsightError

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Answer = Callable[[ServerConnection, Request], Response | None]

LOCAL = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?")
"""Hosts by which a browser asks this machine, at any port, as a tunnel has its own."""
CLOSE_TIMEOUT = 0.1  # given to a browser to answer that the page ends [s]


class Guard:
    """Answers 403 to a request whose Host is not this machine, whose Origin is another page, or that has
    neither the page's token in its URL nor the cookie that was set when it had."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(16)
        # A name for each page, as cookies ignore ports.
        self._cookie = f"handsight-{secrets.token_hex(4)}={self.token}"

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Guards the server that viser starts inside, as it has no option; raises HandsightError if none started."""
        from websockets.asyncio import server

        serve = server.serve
        started = list[Any]()

        def guarded(*args: Any, process_request: "Answer", **options: Any) -> Any:
            answer = partial(self._answer, process_request)
            started.append(serve(*args, process_request=answer, close_timeout=CLOSE_TIMEOUT, **options))
            return started[-1]

        server.serve = guarded  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            server.serve = serve  # type: ignore[misc]
        if not started:
            raise HandsightError("viser: expected a version whose server can be guarded, got another")

    def _answer(
        self, answer: "Answer", connection: "ServerConnection", request: "Request"
    ) -> "Response | None":
        """Returns 403 and the reason, or viser's answer."""
        host = ",".join(request.headers.get_all("Host"))
        origins = request.headers.get_all("Origin")
        fields = parse_qs(request.path.partition("?")[2])
        given = fields.get("token", [""])[0].encode(errors="replace")
        cookies = ";".join(request.headers.get_all("Cookie")).replace(" ", "").split(";")
        if not LOCAL.fullmatch(host):
            return connection.respond(403, f"Host: expected 127.0.0.1 or localhost, got {host!r:.80}\n")
        if origins not in ([], [f"http://{host}"]):
            return connection.respond(403, f"Origin: expected http://{host}, got {','.join(origins)!r:.80}\n")
        if not secrets.compare_digest(given, self.token.encode()) and self._cookie not in cookies:
            return connection.respond(403, "token: expected the complete address that handsight printed\n")
        response = answer(connection, request)
        if response is not None:
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Set-Cookie"] = f"{self._cookie}; HttpOnly; SameSite=Strict"
        return response
