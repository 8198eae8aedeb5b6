"""The web application: login, live frames, downloads and reports; the page itself is mounted beneath."""

import asyncio
import html
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, Response
from pydantic import TypeAdapter
from starlette.background import BackgroundTask
from starlette.datastructures import Headers

from mrd_base import InputError
from mrd_dashboard import stop_button
from mrd_dashboard.access import Sessions
from mrd_dashboard.audit import AuditLog
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.download import pack
from mrd_dashboard.guard import LOGIN, SESSION, STOP, Guard, address_of
from mrd_dashboard.hybrid_view import hybrid_frame

SESSION_OPEN, LOGOUT = "/session", "/logout"
"""A page asks at these paths whether its session is open, and for the end of its session."""

_LONGEST_LOGIN = 4096  # bytes
_TABLE_TYPE = TypeAdapter(dict[str, list[float]])

_LOGIN_PAGE = f"""<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Damper bench</title>
<meta name="viewport" content="width=device-width"><style>
:root{{color-scheme:light dark}}body{{font:16px sans-serif;display:grid;place-items:center;height:95vh}}
form{{display:grid;gap:12px;width:300px}}input,button{{font:inherit;padding:10px}}
.mrd-stop{{position:fixed;top:8px;right:16px;padding:10px 40px;font-weight:700;color:white;background:#c10015;border:0}}
</style>{stop_button.HEAD}</head><body>{stop_button.BODY}<button type="button" class="mrd-stop"
title="Stops rod and coil at once. It needs no login.">STOP</button>
<form method="post"><h1>Damper bench</h1><label for="secret">Password or token</label>
<input id="secret" name="secret" type="password" autofocus required autocomplete="current-password">
<button>Log in</button><p role="alert">MESSAGE</p></form></body></html>"""


def visitor(scope: Any) -> Visitor:
    """Return who sends a request: the address, and a few characters that tell browsers apart but are no key.

    Who has a session may also be named by the address that a proxy tells: it is not proven.
    """
    session, address = str(scope.get(SESSION, "")), address_of(scope)
    if not session:
        return Visitor("", address)
    through = Headers(scope=scope).get("x-forwarded-for", "")[:100]
    return Visitor(session, f"{address} for {through} ({session[-4:]})" if through else f"{address} ({session[-4:]})")


def make_app(dashboard: Dashboard, sessions: Sessions) -> FastAPI:
    """Return the application without its guard."""
    app = FastAPI(openapi_url=None)

    # One guess at a time: each takes a tenth of a second and 64 MB.
    guess = asyncio.Lock()

    @app.post(STOP)
    async def stop(request: Request) -> Response:
        """Ask for the emergency stop. It needs no control, no websocket, and no session."""
        dashboard.emergency_stop(visitor(request.scope))
        return Response(status_code=204)

    @app.get(SESSION_OPEN)
    async def session_open(request: Request) -> Response:
        """Tell a page that is open whether it may still ask for anything; 401 if not."""
        return Response(status_code=204 if request.scope[SESSION] else 401)

    @app.get("/live.json")
    def live() -> Response:
        return _table(dashboard.frame)

    @app.get("/hybrid.json")
    def hybrid() -> Response:
        return _table(lambda: hybrid_frame(dashboard.bench.cycles.latest()))

    @app.get(LOGIN)
    def login_page(ended: bool = False) -> HTMLResponse:
        return HTMLResponse(_login_page("Your session has ended. Log in again." if ended else ""))

    @app.post(LOGIN)
    async def login(request: Request) -> Response:
        body = await _body(request)
        secret = parse_qs(body.decode(errors="replace")).get("secret", [""])[0]
        who = visitor(request.scope)
        try:
            # The hash takes a tenth of a second, in which the page goes on.
            async with guess:
                session = await asyncio.to_thread(sessions.open, secret, address_of(request.scope))
        except InputError as error:
            dashboard.audit.write_seldom(who.name, "login", "", f"refused: {error}")
            return HTMLResponse(_login_page(str(error)), 401)
        dashboard.audit.write(visitor({**request.scope, SESSION: session}).name, "login", "", "done")
        response = RedirectResponse("/", 303)
        response.headers["set-cookie"] = request.app.state.guard.set_cookie(session, request.scope)
        return response

    @app.post(LOGOUT)
    def logout(request: Request) -> Response:
        who = visitor(request.scope)
        dashboard.control.release(who.session)
        sessions.close(who.session)
        dashboard.audit.write(who.name, "logout", "", "done")
        return RedirectResponse("/", 303)

    @app.get("/download/{kind}/{recording:path}")
    async def download(kind: str, recording: str, request: Request) -> Response:
        who = visitor(request.scope)
        try:
            path = dashboard.recordings.find(recording).path
            if kind not in ("bag", "csv"):
                raise InputError(f"{kind}: expected bag or csv")
            file = await dashboard.compute(pack, path, kind)
        except InputError as error:
            dashboard.audit.write(who.name, "download", f"{kind} {recording}"[:200], f"refused: {error}")
            return PlainTextResponse(str(error), 404)
        dashboard.audit.write(who.name, "download", f"{kind} {recording}", "sent")
        folder = file.parent
        return FileResponse(file, filename=file.name, background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True))

    @app.get("/report/{number}")
    def report(number: int, request: Request) -> Response:
        job = next((job for job in dashboard.jobs.all if job.number == number), None)
        if job is None or not job.report.is_file():
            return PlainTextResponse(f"job {number} has no report", 404)
        dashboard.audit.write(visitor(request.scope).name, "report", str(job.report), "sent")
        return _sandboxed(job.report)

    def send(request: Request, asked: str, find: Callable[[], Path], filename: str = "") -> Response:
        """Send a file of the results, or say why there is none; both are logged."""
        who = visitor(request.scope)
        try:
            file = find()
        except InputError as error:
            dashboard.audit.write(who.name, "report", asked[:200], f"refused: {error}")
            return PlainTextResponse(str(error), 404)
        dashboard.audit.write(who.name, "report", str(file), "sent")
        return _sandboxed(file) if file.suffix == ".html" else FileResponse(file, filename=filename)

    @app.get("/bench_diagnosis/{name:path}")
    def bench_diagnosis(name: str, request: Request) -> Response:
        return send(request, name, lambda: dashboard.bench_diagnosis.page(name))

    @app.get("/test/{name}/{test:path}")
    def test_file(name: str, test: str, request: Request) -> Response:
        filename = f"{test.replace('/', '-')}-{name}"
        return send(request, f"{name} {test}", lambda: dashboard.dampers.file(test, name), filename)

    return app


def guarded(app: FastAPI, sessions: Sessions, host: str, port: int, audit: AuditLog, names: str = "") -> Guard:
    """Return the application behind its guard, which logs what it refuses."""
    app.state.guard = Guard(app, sessions, host, port, audit.write_refusal, names)
    return app.state.guard  # type: ignore[no-any-return]


def _sandboxed(page: Path) -> Response:
    # Names and notes in it are of strangers; in a sandbox, no script of it reaches the operator's page.
    return FileResponse(page, media_type="text/html", headers={"content-security-policy": "sandbox allow-scripts"})


def _login_page(message: str) -> str:
    return _LOGIN_PAGE.replace("MESSAGE", html.escape(message))


def _table(compute: Callable[[], dict[str, list[float]]]) -> Response:
    """Return a table as JSON, with null for nan; where it cannot be computed, the reason, which the page shows."""
    try:
        table = compute()
    except Exception as error:
        return PlainTextResponse(f"{type(error).__name__}: {error}; please report this", 500)
    # FastAPI would check each of its numbers first, 30 times a second.
    return Response(_TABLE_TYPE.dump_json(table), media_type="application/json")


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST_LOGIN:
            return b""
    return body
