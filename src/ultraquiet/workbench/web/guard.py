"""Who may speak to the workbench: this machine's browser, at the printed address, with the token of this start.

A page of another site that the same browser shows can send requests to 127.0.0.1, as a form, a script or a websocket,
and by a name of its own that resolves to 127.0.0.1. So every request and every websocket must name this very host
(`Host`), come from a page of it where it says from which (`Origin`, `Sec-Fetch-Site`), and carry the token: in the
printed address once, afterwards in a cookie that other sites' pages never send (`SameSite=Strict`).
"""

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HOSTS = ("127.0.0.1", "localhost")
TOKEN_BYTES = 32
# Vue compiles templates in the page; nothing is ever fetched from, sent to or framed by another host.
POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'self'; base-uri 'self'; object-src 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "x-frame-options": "DENY",
}
REFUSED_WORDS = (
    "The workbench answers only the address that `ultraquiet serve` printed, on this machine, with its token. "
    "Copy that line into the browser once more; every start has a new one.\n"
)


def new_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class RequestGuard:
    """An ASGI application in front of another, which sees only requests that may pass.

    Args:
        app: what is guarded.
        port: on which it is served.
        token: of this start.
    """

    def __init__(self, app: App, port: int, token: str) -> None:
        self._app, self._token = app, token.encode()
        self._hosts = tuple(f"{host}:{port}" for host in HOSTS)
        self._origins = tuple(f"http://{host}" for host in self._hosts)
        self.cookie = f"ultraquiet-{port}"  # cookies know no ports: another workbench has one by its side

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1") for key, value in scope["headers"]}
        by_address = self._is_token(_asked_token(scope))
        if not self._is_ours(headers) or not (by_address or self._is_token(self._kept_token(headers))):
            await _refuse(scope, receive, send)
            return
        await self._app(scope, receive, self._marked(send, by_address) if scope["type"] == "http" else send)

    def _is_ours(self, headers: MutableMapping[str, str]) -> bool:
        origin = headers.get("origin")
        return (
            headers.get("host") in self._hosts
            and (origin is None or origin in self._origins)
            and headers.get("sec-fetch-site", "none") in ("none", "same-origin")
        )

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self._token)

    def _kept_token(self, headers: MutableMapping[str, str]) -> str:
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return ""
        return "" if kept is None else kept.value

    def _marked(self, send: Send, first: bool) -> Send:
        """Return what sends an answer with the headers that keep it on this machine, and the cookie once."""
        own = [(key.encode(), value.encode()) for key, value in HEADERS.items()]
        if first:
            cookie = f"{self.cookie}={self._token.decode()}; Path=/; HttpOnly; SameSite=Strict"
            own.append((b"set-cookie", cookie.encode()))

        async def marked(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *own]
            await send(message)

        return marked


def _asked_token(scope: Scope) -> str:
    given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])
    return given[0] if len(given) == 1 else ""


async def _refuse(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": REFUSED_WORDS.encode()})
