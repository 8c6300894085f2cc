"""Who may use the page: the gate in front of the web application, for requests and WebSockets.

1. A browser gets in with the token of the URL that the command printed. It is exchanged at once for a cookie that scripts
   cannot read (HttpOnly) and that other sites' pages do not send (SameSite=Strict); the address bar keeps no token.
2. Every request names this host; one that says which page it comes from must come from this one. A WebSocket must say it.
3. What is wrong is refused (403) with its reason, before the application sees it.

*Fact*: browsers do not keep cookies of two ports of one host apart, and call two ports "same site". So the cookie's name
has the port, and `Origin` and `Sec-Fetch-Site` are looked at, too. `aces_lab.foxglove.origins` looks at the first request
of a connection alone, which is enough for WebSockets and not for a page.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, TypeAlias
from urllib.parse import parse_qs, urlsplit

Message: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[Message]]
Send: TypeAlias = Callable[[Message], Awaitable[None]]
Application: TypeAlias = Callable[[Message, Receive, Send], Awaitable[None]]

#: WebSockets that are open at once: a page has one.
MOST_SOCKETS = 16
#: Code of a WebSocket that is refused (RFC 6455 §7.4.1: policy violation).
POLICY_VIOLATION = 1008
#: Of every answer. Nothing is loaded from elsewhere, no page frames this one, no address is handed on.
HEADERS: tuple[tuple[bytes, bytes], ...] = (
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (
        b"content-security-policy",
        # Vue compiles templates in the page (unsafe-eval); NiceGUI's page has scripts and styles of its own in it.
        b"default-src 'self' 'unsafe-inline' 'unsafe-eval'; img-src 'self' data: blob:; font-src 'self' data:;"
        b" connect-src 'self'; frame-ancestors 'none'; form-action 'self'; base-uri 'self'; object-src 'none'",
    ),
)


class PageGate:
    """An ASGI application in front of another: lets in who has the token, or its cookie.

    `port` is the one that the page is served at on loopback. `refusals` counts what was not let in, `sockets` what is open.
    """

    def __init__(self, application: Application, port: int) -> None:
        self._application = application
        self.token, self._cookie = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self.cookie_name = f"aces_studio_{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}
        self.sockets = self.refusals = 0

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Serve a request or a WebSocket, or refuse it."""
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        headers = _headers(scope["headers"])
        reason = self._fault(scope, headers, is_socket)
        if not reason and not is_socket and (token := _token(scope)) is not None:
            if hmac.compare_digest(token.encode(), self.token.encode()):
                await self._enter(scope, send)
                return
            reason = "this token is not of this studio: take the address that the command printed last"
        if not reason and not self._has_cookie(headers):
            reason = "no cookie: open the address that 'aces studio' printed, with its token"
        if not reason and is_socket and self.sockets >= MOST_SOCKETS:
            reason = f"{MOST_SOCKETS} pages are open already: close one"
        if reason:
            self.refusals += 1
            await _refuse(send, reason, is_socket)
            return
        self.sockets += is_socket
        try:
            await self._application(scope, receive, send if is_socket else _with_headers(send))
        finally:
            self.sockets -= is_socket

    def _fault(self, scope: Message, headers: dict[str, list[str]], is_socket: bool) -> str:
        """Return what is wrong with where a request comes from, or goes to; "" is nothing."""
        if (client := scope.get("client")) is not None and client[0] not in ("127.0.0.1", "::1"):
            return "only programs of this machine may come"
        hosts, origins = headers.get("host", []), headers.get("origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return "another host's name: write 127.0.0.1"
        if len(origins) > 1 or any(origin.lower() not in self._origins for origin in origins):
            return "pages of another origin may not come"
        if is_socket and not origins:
            return "a WebSocket has to say its origin"
        # A click on a link elsewhere that leads here is "cross-site"; it has to bring the token.
        if headers.get("sec-fetch-site", ["none"])[0] not in ("none", "same-origin") and (
            _token(scope) is None or headers.get("sec-fetch-mode") != ["navigate"]
        ):
            return "pages of another site may not come"
        return ""

    def _has_cookie(self, headers: dict[str, list[str]]) -> bool:
        for line in headers.get("cookie", []):
            try:
                found = SimpleCookie(line).get(self.cookie_name)
            except CookieError:
                continue
            if found is not None and hmac.compare_digest(found.value.encode(), self._cookie.encode()):
                return True
        return False

    async def _enter(self, scope: Message, send: Send) -> None:
        """Exchange the token for the cookie, and lead to the same page without the token."""
        cookie = f"{self.cookie_name}={self._cookie}; HttpOnly; SameSite=Strict; Path=/"
        headers = [(b"location", b"/"), (b"set-cookie", cookie.encode()), (b"cache-control", b"no-store")]
        await send({"type": "http.response.start", "status": 303, "headers": [*headers, *HEADERS]})
        await send({"type": "http.response.body", "body": b""})


def _headers(pairs: Iterable[tuple[bytes, bytes]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in pairs:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1").strip())
    return found


def _token(scope: Message) -> str | None:
    """Return the token in the query of the first page's address, None where there is none."""
    if scope.get("path") != "/":
        return None
    query = scope.get("query_string", b"").decode("latin-1")
    return next(iter(parse_qs(urlsplit(f"?{query}").query).get("token", [])), None)


async def _refuse(send: Send, reason: str, is_socket: bool) -> None:
    if is_socket:  # before it is accepted: the server answers 403
        await send({"type": "websocket.close", "code": POLICY_VIOLATION, "reason": reason})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": f"{reason}\n".encode()})


def _with_headers(send: Send) -> Send:
    """Return a `send` that adds `HEADERS` to the answer."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            ours = {name for name, _ in HEADERS}
            kept = [pair for pair in message.get("headers", ()) if pair[0].lower() not in ours]
            message = {**message, "headers": [*kept, *HEADERS]}
        await send(message)

    return sending
