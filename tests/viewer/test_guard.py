"""Who may read the page: the browser that was given its address, and nothing else on this machine or another."""

import socket
import time
import urllib.error
import urllib.request

import pytest

from testbed.refusals import refused

viser = pytest.importorskip("viser", reason="the page needs handsight[view]")
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402


def got(player, path, **headers):
    """Status, text and cookie of a GET."""
    request = urllib.request.Request(f"http://127.0.0.1:{player.port}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read().decode(), answer.headers["Set-Cookie"]
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read().decode(), refused.headers["Set-Cookie"]


def cookie(player):
    """What a browser that has opened the page sends."""
    return got(player, f"/?token={player.guard.token}")[2].partition(";")[0]


def socket_of(player, path="/", origin=None, **headers):
    address = f"ws://127.0.0.1:{player.port}{path}"
    return connect(
        address, origin=origin, additional_headers=headers, subprotocols=[f"viser-v{viser.__version__}"]
    )


def refused_socket(player, *given, **headers):
    with pytest.raises(InvalidStatus) as error, socket_of(player, *given, **headers):
        pass
    return error.value.response.status_code


def test_the_printed_address_opens_the_page_and_its_cookie_the_socket(player):
    status, text, given = got(player, f"/?token={player.guard.token}")
    assert (status, "<html" in text) == (200, True)
    assert given.endswith("; HttpOnly; SameSite=Strict")
    own = f"http://127.0.0.1:{player.port}"
    with socket_of(player, origin=own, Cookie=f"other=1; {cookie(player)}") as socket:
        assert len(socket.recv(timeout=20)) > 1000
    assert got(player, "/", Cookie=cookie(player))[0] == 200


def test_a_page_of_another_site_reads_nothing(player):
    """It may know the port, and a browser sends it the cookie if it is served from this machine too."""
    for origin in (
        "http://evil.example",
        "null",
        f"http://127.0.0.1:{player.port + 1}",
        f"https://127.0.0.1:{player.port}",
    ):
        assert refused_socket(player, "/", origin, Cookie=cookie(player)) == 403
        assert refused_socket(player, f"/?token={player.guard.token}", origin) == 403
    status, text, given = got(player, f"/?token={player.guard.token}", Origin="http://evil.example")
    assert (status, given) == (403, None)
    assert text == f"Origin: expected http://127.0.0.1:{player.port}, got 'http://evil.example'\n"


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "127.0.0.2", "[", "localhost:x"]
)
def test_a_name_that_leads_here_reads_nothing(player, host):
    status, text, given = got(player, f"/?token={player.guard.token}", Host=host)
    assert (status, given) == (403, None)
    assert text == f"Host: expected 127.0.0.1 or localhost, got {host!r}\n"


def test_a_tunnel_at_another_port_is_this_machine(player):
    for host in ("localhost:9000", "127.0.0.1:1", "[::1]:9000", "localhost"):
        assert got(player, f"/?token={player.guard.token}", Host=host, Origin=f"http://{host}")[0] == 200


@pytest.mark.parametrize("query", ["", "?token=", "?token=A", "?token=%ff", "?tok=1&t=3"])
def test_without_the_token_nobody_reads_anything(player, query):
    status, text, given = got(player, f"/{query}", Cookie="handsight-0=; a=b")
    assert (status, given) == (403, None)
    assert text == "token: expected the complete address that handsight printed\n"
    assert refused_socket(player, f"/{query}") == 403


def test_each_page_has_a_token_of_its_own(player, tracked):
    from handsight.viewer.player import Player

    other = Player(tracked.rig, tracked.model, port=player.port)
    try:
        assert other.guard.token != player.guard.token
        assert got(other, "/", Cookie=cookie(player))[0] == 403
        assert cookie(other).partition("=")[0] != cookie(player).partition("=")[0]
    finally:
        other.close()


def test_a_server_that_cannot_be_guarded_is_not_used(tracked, monkeypatch):
    from handsight.errors import HandsightError
    from handsight.viewer.player import Player

    monkeypatch.setattr(viser, "ViserServer", lambda **_: None)
    with refused(HandsightError, "viser"):
        Player(tracked.rig, tracked.model)


def test_a_page_ends_within_a_second_although_a_browser_does_not_answer(player):
    asked = "\r\n".join(
        [
            *("GET / HTTP/1.1", f"Host: 127.0.0.1:{player.port}", f"Cookie: {cookie(player)}"),
            *(
                "Connection: Upgrade",
                "Upgrade: websocket",
                f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
            ),
            *("Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==", "\r\n"),
        ]
    )
    with socket.create_connection(("127.0.0.1", player.port)) as silent:
        silent.sendall(asked.encode())
        assert silent.recv(12) == b"HTTP/1.1 101"
        began = time.monotonic()
        player.close()
        assert time.monotonic() - began < 1.0
        assert not player.server._websock_server._server_thread.is_alive()
