"""The gate of the studio: who is let in, who is refused, what an answer carries."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aces_lab.studio.gate import MOST_SOCKETS, Message, PageGate

PORT = 4711
HOST, ORIGIN = f"127.0.0.1:{PORT}", f"http://127.0.0.1:{PORT}"


async def _page(scope: Message, receive: Any, send: Any) -> None:
    """An application that lets everybody in."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        await receive()
        return
    await send(
        {"type": "http.response.start", "status": 200, "headers": [(b"x-frame-options", b"SAMEORIGIN")]}
    )
    await send({"type": "http.response.body", "body": b"page"})


def _scope(kind: str, query: str = "", path: str = "/", client: str = "127.0.0.1", **headers: str) -> Message:
    given = {"host": HOST, **{name.replace("_", "-"): value for name, value in headers.items()}}
    return {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "client": (client, 50_000),
        "headers": [(name.encode(), value.encode()) for name, value in given.items() if value],
    }


def answer(gate: PageGate, scope: Message) -> list[Message]:
    """What the gate sends."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "websocket.disconnect"}

    asyncio.run(gate(scope, receive, send))
    return sent


def status(gate: PageGate, scope: Message) -> int:
    return int(answer(gate, scope)[0]["status"])


def cookie(gate: PageGate) -> str:
    """The cookie that the token is exchanged for."""
    sent = answer(gate, _scope("http", f"token={gate.token}"))
    found = next(value for name, value in sent[0]["headers"] if name == b"set-cookie")
    return str(found.decode().split(";")[0])


@pytest.fixture
def gate() -> PageGate:
    return PageGate(_page, PORT)


def test_the_token_becomes_a_cookie_and_leaves_the_address(gate: PageGate) -> None:
    """The token is exchanged at once for a cookie that scripts cannot read and other sites do not send."""
    sent = answer(gate, _scope("http", f"token={gate.token}"))
    headers = dict(sent[0]["headers"])
    assert sent[0]["status"] == 303
    assert headers[b"location"] == b"/"
    given = headers[b"set-cookie"].decode()
    assert "HttpOnly" in given
    assert "SameSite=Strict" in given
    assert gate.token not in given
    assert headers[b"referrer-policy"] == b"no-referrer"
    assert status(gate, _scope("http", cookie=given.split(";")[0])) == 200


def test_an_answer_carries_the_headers_of_the_gate(gate: PageGate) -> None:
    """The gate's headers take the place of the application's of the same name."""
    headers = answer(gate, _scope("http", cookie=cookie(gate)))[0]["headers"]
    assert dict(headers)[b"x-frame-options"] == b"DENY"
    assert [name for name, _ in headers].count(b"x-frame-options") == 1
    assert b"frame-ancestors 'none'" in dict(headers)[b"content-security-policy"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"cookie": ""},
        {"cookie": f"aces_studio_{PORT}=wrong"},
        {"cookie": f"aces_studio_{PORT + 1}=right"},
        {"host": "evil.example"},
        {"host": f"127.0.0.1:{PORT + 1}"},
        {"host": ""},
        {"origin": "http://evil.example"},
        {"origin": f"http://127.0.0.1:{PORT + 1}"},
        {"origin": "null"},
        {"sec_fetch_site": "cross-site"},
        {"sec_fetch_site": "same-site"},
    ],
)
def test_another_origin_host_or_cookie_is_refused(gate: PageGate, wrong: dict[str, str]) -> None:
    """Pages of other origins, other names of this host and whoever has no cookie get 403, and a WebSocket is closed."""
    right = cookie(gate)
    given = {"cookie": right, **{name: value.replace("right", right) for name, value in wrong.items()}}
    assert status(gate, _scope("http", **given)) == 403
    assert answer(gate, _scope("websocket", **{"origin": ORIGIN, **given}))[0]["type"] == "websocket.close"
    assert gate.refusals == 2


def test_a_wrong_token_is_refused(gate: PageGate) -> None:
    """A token of another run is refused, also with a cookie."""
    assert status(gate, _scope("http", "token=wrong")) == 403
    assert status(gate, _scope("http", "token=wrong", cookie=cookie(gate))) == 403


def test_a_link_elsewhere_may_lead_here_with_the_token_alone(gate: PageGate) -> None:
    """A click on the address in a web mail is let in; what a page of another site loads is not."""
    token = f"token={gate.token}"
    assert status(gate, _scope("http", token, sec_fetch_site="cross-site", sec_fetch_mode="navigate")) == 303
    assert status(gate, _scope("http", token, sec_fetch_site="cross-site", sec_fetch_mode="no-cors")) == 403
    assert status(gate, _scope("http", "token=x", path="/other", cookie=cookie(gate))) == 200


def test_another_machine_is_refused(gate: PageGate) -> None:
    """Whoever does not come over loopback is refused, whatever it knows."""
    assert status(gate, _scope("http", f"token={gate.token}", client="192.0.2.1")) == 403


def test_a_websocket_says_its_origin(gate: PageGate) -> None:
    """A WebSocket of the page is let in; one that does not say its origin is not."""
    right = cookie(gate)
    assert answer(gate, _scope("websocket", origin=ORIGIN, cookie=right))[0]["type"] == "websocket.accept"
    assert answer(gate, _scope("websocket", cookie=right))[0]["type"] == "websocket.close"
    assert answer(gate, _scope("websocket", origin=ORIGIN))[0]["type"] == "websocket.close"


def test_fifty_sockets_are_not_open_at_once(gate: PageGate) -> None:
    """The number of open WebSockets is bounded; what is beyond is closed with the reason."""
    right = cookie(gate)

    async def run() -> list[str]:
        gone, sent = asyncio.Event(), list[str]()

        async def receive() -> Message:
            await gone.wait()
            return {"type": "websocket.disconnect"}

        async def send(message: Message) -> None:
            sent.append(str(message["type"]))

        tasks = [
            asyncio.create_task(gate(_scope("websocket", origin=ORIGIN, cookie=right), receive, send))
            for _ in range(50)
        ]
        for _ in range(3):
            await asyncio.sleep(0)
        gone.set()
        await asyncio.gather(*tasks)
        return sent

    sent = asyncio.run(run())
    assert sent.count("websocket.accept") == MOST_SOCKETS
    assert sent.count("websocket.close") == 50 - MOST_SOCKETS
    assert gate.sockets == 0
