"""The web server of the page, in a thread of its own."""

import asyncio
import threading
import time

import uvicorn
from nicegui import ui

from mrd_base import InputError
from mrd_dashboard.access import Credentials, Sessions, require_safe_host
from mrd_dashboard.dashboard import Dashboard, work_through_queue
from mrd_dashboard.guard import Guard
from mrd_dashboard.pages.shell import page
from mrd_dashboard.web import guarded, make_app

_START_TIMEOUT = 20.0  # s
_POLL = 0.2  # s
_RECONNECT_TIMEOUT = 20.0  # s


def server_config(app: Guard, host: str, port: int) -> uvicorn.Config:
    """Return how an application is served at an address."""
    # Anybody on this machine may send the headers of a proxy: an address in one must not stand for that of the connection,
    # by which wrong passwords are counted.
    return uvicorn.Config(
        app, host, port, log_level="warning", access_log=False, proxy_headers=False, timeout_graceful_shutdown=1
    )


class PageServer:
    """Serves the page of a dashboard; one in a process, because NiceGUI has one application.

    Parameters
    ----------
    dashboard : Dashboard
    host, port : str, int
        Where the page is served.
    credentials : Credentials or None
        Who may log in; None lets everybody on this machine in.
    names : str
        Names by which browsers reach the page, as of `Guard`.

    Attributes
    ----------
    url : str
    loop : asyncio.AbstractEventLoop
        The loop in which the pages run, once the server is up.

    Raises
    ------
    InputError
        When the host is open to others and nobody would have to log in, or when the port is taken.
    """

    loop: asyncio.AbstractEventLoop

    def __init__(self, dashboard: Dashboard, host: str, port: int, credentials: Credentials | None, names: str = "") -> None:
        require_safe_host(host, credentials)
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        sessions = Sessions(credentials)
        app = make_app(dashboard, sessions)

        def root() -> None:
            page(dashboard, login=sessions.needs_login)

        # Forms outlive a network, or a machine, that is away for a while: after it, a browser would load the page again.
        ui.run_with(
            app, root=root, title="Damper bench", dark=None, show_welcome_message=False, reconnect_timeout=_RECONNECT_TIMEOUT
        )
        self._dashboard = dashboard
        guard = guarded(app, sessions, host, port, dashboard.audit, names)
        self._server = uvicorn.Server(server_config(guard, host, port))
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        deadline = time.monotonic() + _START_TIMEOUT
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise InputError(
                    f"port {port} of {host} cannot be served; end the program that has it, or choose another port"
                )
            time.sleep(0.01)

    def _run(self) -> None:
        # uvicorn ends by SystemExit where it cannot listen.
        try:
            asyncio.run(self._serve())
        except SystemExit:
            return

    async def _serve(self) -> None:
        self.loop = asyncio.get_running_loop()
        tasks = [asyncio.create_task(work_through_queue(self._dashboard)), asyncio.create_task(self._hear_jobs())]
        try:
            await self._server.serve()
        finally:
            for task in tasks:
                task.cancel()

    async def _hear_jobs(self) -> None:
        while True:
            self._dashboard.hear_jobs()
            await asyncio.sleep(_POLL)

    def close(self) -> None:
        """End the server and the computations that it started. Runs that are under way go on; the bench ends them."""
        self._server.should_exit = True
        self._thread.join(5.0)
        self._dashboard.jobs.cancel()
