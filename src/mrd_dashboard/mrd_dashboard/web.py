"""The web application: login, live frames, downloads and reports; the page itself is mounted beneath."""

import asyncio
import shutil
import tempfile
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.background import BackgroundTask

from mrd_base import InputError
from mrd_dashboard.access import Sessions
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.guard import LOGIN, SESSION, Guard
from mrd_dashboard.hybrid_view import hybrid_frame
from mrd_runs.csv_export import export_csv

_LONGEST_LOGIN = 4096  # bytes

_LOGIN_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Damper bench</title>
<meta name="viewport" content="width=device-width"><style>
:root{{color-scheme:light dark}}body{{font:16px sans-serif;display:grid;place-items:center;height:95vh}}
form{{display:grid;gap:12px;width:300px}}input,button{{font:inherit;padding:10px}}</style></head><body>
<form method="post"><h1>Damper bench</h1><label for="secret">Password or token</label>
<input id="secret" name="secret" type="password" autofocus required autocomplete="current-password">
<button>Log in</button><p role="alert">{message}</p></form></body></html>"""


def visitor(scope: Any) -> Visitor:
    """Return who sends a request: the address, and a few characters that tell browsers apart but are no key."""
    session = str(scope.get(SESSION, ""))
    address = (scope.get("client") or ("this machine",))[0]
    return Visitor(session, f"{address} ({session[-4:]})" if session else str(address))


def make_app(dashboard: Dashboard, sessions: Sessions) -> FastAPI:
    """Return the application without its guard."""
    app = FastAPI(openapi_url=None)

    @app.get("/live.json")
    def live() -> dict[str, list[float]]:
        return dashboard.frame()

    @app.get("/hybrid.json")
    def hybrid() -> dict[str, list[float]]:
        return hybrid_frame(dashboard.bench.cycles.latest())

    @app.get(LOGIN)
    def login_page() -> HTMLResponse:
        return HTMLResponse(_LOGIN_PAGE.format(message=""))

    @app.post(LOGIN)
    async def login(request: Request) -> Response:
        body = await _body(request)
        secret = parse_qs(body.decode(errors="replace")).get("secret", [""])[0]
        who = visitor(request.scope)
        try:
            # The hash takes a tenth of a second, in which the page goes on.
            session = await asyncio.to_thread(sessions.open, secret)
        except InputError as error:
            dashboard.audit.write(who.name, "login", "", f"refused: {error}")
            return HTMLResponse(_LOGIN_PAGE.format(message=error), 401)
        dashboard.audit.write(visitor({**request.scope, SESSION: session}).name, "login", "", "done")
        response = RedirectResponse("/", 303)
        response.headers["set-cookie"] = request.app.state.guard.set_cookie(session)
        return response

    @app.post("/logout")
    def logout(request: Request) -> Response:
        who = visitor(request.scope)
        dashboard.control.release(who.session)
        sessions.close(who.session)
        dashboard.audit.write(who.name, "logout", "", "done")
        return RedirectResponse("/", 303)

    @app.get("/download/{kind}/{recording:path}")
    async def download(kind: str, recording: str) -> Response:
        try:
            path = dashboard.recordings.find(recording).path
            if kind not in ("bag", "csv"):
                raise InputError(f"{kind}: expected bag or csv")
            file = await asyncio.to_thread(_packed, path, kind)
        except InputError as error:
            return PlainTextResponse(str(error), 404)
        folder = file.parent
        return FileResponse(file, filename=file.name, background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True))

    @app.get("/report/{number}")
    def report(number: int) -> Response:
        job = next((job for job in dashboard.jobs.all if job.number == number), None)
        if job is None or not job.report.is_file():
            return PlainTextResponse(f"job {number} has no report", 404)
        # Names and notes in it are of strangers; in a sandbox, no script of it reaches the page.
        return FileResponse(job.report, media_type="text/html", headers={"content-security-policy": "sandbox allow-scripts"})

    return app


def guarded(app: FastAPI, sessions: Sessions, host: str, port: int) -> Guard:
    """Return the application behind its guard."""
    app.state.guard = Guard(app, sessions, host, port)
    return app.state.guard  # type: ignore[no-any-return]


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST_LOGIN:
            return b""
    return body


def _packed(recording: Path, kind: str) -> Path:
    """Return a new file, in a folder of its own, with a recording as zipped bag or with its samples as CSV."""
    folder = Path(tempfile.mkdtemp(prefix="mrd_download_"))
    try:
        if kind == "bag":
            return Path(shutil.make_archive(str(folder / recording.name), "zip", recording.parent, recording.name))
        target = folder / f"{recording.name}.csv"
        export_csv(recording, target)
        return target
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
