"""What stands before the page: only this bench's own pages, in logged-in browsers, reach it."""

import re
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from mrd_dashboard.access import Sessions, is_address, is_local

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
Log = Callable[[str, int, str, str], None]

LOGIN, STOP = "/login", "/stop"
"""Paths that need no session: of the login, and of the emergency stop, which one must be able to ask for when a session has
ended or the server was started again. A stop too many costs a run."""
SESSION = "mrd_session"
"""Key under which the scope of a request tells its session."""

_HEADERS = {
    "x-frame-options": "SAMEORIGIN",  # no other site shows the stop button in a frame
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
}


def address_of(scope: Scope) -> str:
    """Return the address from which a request comes: of the connection, which no header can change."""
    return str((scope.get("client") or ("this machine",))[0])


class Guard:
    """Refuses requests that other sites send, and lets in who has a session.

    Parameters
    ----------
    app : callable
        The application behind it (ASGI).
    sessions : Sessions
    host : str
        Address at which the page is served.
    port : int
        It is part of the cookie's name: cookies do not tell ports apart, and two benches may be open.
    log : callable
        Receives address, status, path and reason of each refusal.
    names : str
        Names, with spaces between, by which browsers reach the page beside addresses and the names of this machine.
    """

    def __init__(
        self, app: App, sessions: Sessions, host: str, port: int, log: Log = lambda *_: None, names: str = ""
    ) -> None:
        self._app, self._sessions, self._log = app, sessions, log
        self._local = is_local(host) and not sessions.needs_login
        machine = socket.gethostname()
        self._names = {name.lower() for name in ("localhost", host, machine, f"{machine}.local", *names.split())}
        self.cookie = f"mrd_session_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if refusal := self._foreign(scope, headers):
            await self._refuse(PlainTextResponse(refusal, 403), refusal, scope, receive, send)
            return
        session, new = self._session(headers), False
        if not session:
            wants_page = scope["type"] == "http" and scope["method"] == "GET" and "text/html" in headers.get("accept", "")
            if not self._sessions.needs_login:
                if wants_page:
                    session, new = self._sessions.open(), True
                elif scope["type"] == "websocket":
                    await self._refuse(PlainTextResponse("", 401), "no session; load the page again", scope, receive, send)
                    return
            elif scope["type"] == "websocket" or scope["path"] not in (LOGIN, STOP):
                answer: Response = RedirectResponse(LOGIN, 303) if wants_page else PlainTextResponse("log in first", 401)
                await self._refuse(answer, "not logged in", scope, receive, send)
                return
        scope[SESSION] = session
        if scope["type"] == "websocket":
            await self._app(scope, self._while_open(session, receive), send)
            return

        async def send_with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                answer_headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    answer_headers.setdefault(name, value)
                if new:
                    answer_headers.append("set-cookie", self.set_cookie(session, scope))
            await send(message)

        await self._app(scope, receive, send_with_headers)

    def set_cookie(self, session: str, scope: Scope) -> str:
        """Return the header that gives a browser its session; no script can read it, and no other site can send it."""
        by_tls = "https" in (scope["scheme"], Headers(scope=scope).get("x-forwarded-proto"))
        secure = "; Secure" if by_tls else ""
        return f"{self.cookie}={session}; Path=/; HttpOnly; SameSite=Lax{secure}"

    def _while_open(self, session: str, receive: Receive) -> Receive:
        """Return what a websocket hears: nothing more once its session has ended."""

        async def receive_while_open() -> MutableMapping[str, Any]:
            message = await receive()
            return message if self._sessions.is_open(session) else {"type": "websocket.disconnect", "code": 1008}

        return receive_while_open

    def _session(self, headers: Headers) -> str:
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return ""
        return morsel.value if morsel and self._sessions.is_open(morsel.value) else ""

    def _foreign(self, scope: Scope, headers: Headers) -> str:
        """Return why a request is taken for one that another site sends, or ""."""
        host = headers.get("host", "")
        # Another site may let its own name lead to this machine; the browser would then take it for the same site.
        name = re.sub(r":\d*$", "", host).lower().removeprefix("[").removesuffix("]")
        if self._local and not is_local(name):
            return f"the page is served to this machine only, not as {host[:100]}"
        if not self._local and name not in self._names and not is_address(name):
            return f"the page is not known as {host[:100]}; if this is a name of the bench, add it to the parameter names"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] != host:
            return f"the request comes from {origin[:100]}, not from this page"
        opens_page = scope["type"] == "http" and scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none") and not opens_page:
            return "the request comes from another site"
        return ""

    async def _refuse(self, response: Response, reason: str, scope: Scope, receive: Receive, send: Send) -> None:
        # A visit that is led to the login is no refusal.
        if response.status_code >= 400:
            self._log(address_of(scope), response.status_code, scope["path"], reason)
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await response(scope, receive, send)
