"""Who may open the page, and who may command the bench."""

import asyncio
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from urllib.parse import unquote

import httpx
import pytest

from mrd_base import InputError
from mrd_dashboard.access import (
    MOST_FAILURES,
    PAUSE,
    SESSION_TIME,
    Credentials,
    Sessions,
    hash_password,
    password_matches,
    read_credentials,
    require_safe_host,
    write_credentials,
)
from mrd_dashboard.control_right import ABSENCE, ControlRight
from mrd_dashboard.web import guarded, make_app

PASSWORD = "slow damper 7"


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def credentials() -> Credentials:
    return Credentials(hash_password(PASSWORD))


class Browser:
    """Keeps cookies, and does not follow redirections."""

    def __init__(self, dashboard, sessions: Sessions, host: str = "127.0.0.1") -> None:
        self.app = guarded(make_app(dashboard, sessions), sessions, host, 8080)
        self.cookies = httpx.Cookies()

    def request(self, method: str, path: str, **options) -> httpx.Response:
        async def send() -> httpx.Response:
            transport = httpx.ASGITransport(self.app)
            async with httpx.AsyncClient(
                transport=transport, base_url="http://127.0.0.1:8080", cookies=self.cookies
            ) as client:
                answer = await client.request(method, path, **options)
                self.cookies = client.cookies
                return answer

        return asyncio.run(send())

    def get(self, path: str, **options) -> httpx.Response:
        return self.request("GET", path, **options)

    def post(self, path: str, **options) -> httpx.Response:
        return self.request("POST", path, **options)

    def websocket(self, **headers: str) -> str:
        """Return the type of the first answer to a websocket."""
        cookies = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        sent = {
            "host": "127.0.0.1:8080",
            "cookie": cookies,
            **{key.replace("_", "-"): value for key, value in headers.items()},
        }
        scope = {
            "type": "websocket",
            "path": "/_nicegui_ws/socket.io",
            "headers": [(name.encode(), value.encode()) for name, value in sent.items()],
            "query_string": b"",
            "subprotocols": [],
        }
        answers = []

        async def receive():
            return {"type": "websocket.connect"}

        async def send(message) -> None:
            answers.append(message["type"])

        reached = []

        async def behind(scope, receive, send) -> None:
            reached.append(scope)

        guard, self.app._app = self.app._app, behind
        asyncio.run(self.app(scope, receive, send))
        self.app._app = guard
        return "reached" if reached else answers[0]


def test_a_password_is_kept_as_a_salted_hash() -> None:
    first, second = hash_password(PASSWORD), hash_password(PASSWORD)
    assert first != second
    assert PASSWORD not in first
    assert password_matches(first, PASSWORD)
    assert not password_matches(first, PASSWORD + " ")


def test_a_short_password_is_refused() -> None:
    with pytest.raises(InputError, match="at least 10"):
        hash_password("123456789")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "bench.example"])
def test_an_open_host_is_refused_without_credentials(host: str, credentials: Credentials) -> None:
    with pytest.raises(InputError, match="access"):
        require_safe_host(host, None)
    require_safe_host(host, credentials)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1"])
def test_this_machine_needs_no_credentials(host: str) -> None:
    require_safe_host(host, None)


def test_the_access_file_is_for_its_owner_only(tmp_path: Path, credentials: Credentials) -> None:
    file = tmp_path / "access.yaml"
    write_credentials(credentials, file)
    assert read_credentials(file) == credentials
    file.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        read_credentials(file)


@pytest.mark.parametrize("content", ["password: plain words\n", "tokens: []\n", "tokens: 5\n", "passwort: x\n"])
def test_a_useless_access_file_is_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "access.yaml"
    file.write_text(content)
    file.chmod(0o600)
    with pytest.raises(InputError, match="access"):
        read_credentials(file)


def test_the_tool_writes_password_and_token(tmp_path: Path) -> None:
    file, tool = tmp_path / "access.yaml", [sys.executable, "-m", "mrd_dashboard.cli.access"]
    subprocess.run([*tool, file], input=PASSWORD + "\n", text=True, check=True)
    token = subprocess.run([*tool, file, "--token", "2"], capture_output=True, text=True, check=True).stdout.strip()
    stored = read_credentials(file)
    assert token not in file.read_text()
    expires = stored.tokens[0].expires
    assert stored.accepts(PASSWORD, 0.0)
    assert stored.accepts(token, expires - 1)
    assert not stored.accepts(token, expires + 1)


def test_a_session_ends(credentials: Credentials) -> None:
    clock = Clock()
    sessions = Sessions(credentials, clock)
    session = sessions.open(PASSWORD)
    clock.now += SESSION_TIME - 1
    assert sessions.is_open(session)
    clock.now += 2
    assert not sessions.is_open(session)


def test_guessing_is_slowed_down(credentials: Credentials) -> None:
    clock = Clock()
    sessions = Sessions(credentials, clock)
    for _ in range(MOST_FAILURES):
        with pytest.raises(InputError, match="wrong"):
            sessions.open("wrong password")
    with pytest.raises(InputError, match="too many"):
        sessions.open(PASSWORD)
    clock.now += PAUSE + 1
    assert sessions.open(PASSWORD)


# The guard


def test_nobody_enters_without_logging_in(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    assert client.get("/live.json").status_code == 401
    assert client.websocket() == "websocket.close"
    answer = client.get("/", headers={"accept": "text/html"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    refused = client.post("/login", data={"secret": "wrong password"})
    assert refused.status_code == 401
    assert client.get("/live.json").status_code == 401
    entered = client.post("/login", data={"secret": PASSWORD})
    assert entered.status_code == 303
    assert "HttpOnly" in entered.headers["set-cookie"]
    assert client.get("/live.json").status_code == 200
    client.post("/logout")
    assert client.get("/live.json").status_code == 401
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [(entry["action"], entry["result"].partition(":")[0]) for entry in log] == [
        ("login", "refused"),
        ("login", "done"),
        ("logout", "done"),
    ]
    assert PASSWORD not in dashboard.audit.path.read_text()


def test_on_this_machine_everybody_gets_a_session(dashboard) -> None:
    client = Browser(dashboard, Sessions(None))
    assert client.get("/live.json").status_code == 200
    assert client.cookies


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
        {"host": "evil.example:8080"},
    ],
)
def test_requests_of_other_sites_are_refused(dashboard, headers) -> None:
    client = Browser(dashboard, Sessions(None))
    assert client.get("/live.json").status_code == 200
    assert client.post("/logout", headers=headers).status_code == 403
    assert client.get("/live.json", headers=headers).status_code == 403
    assert client.websocket(**{name.replace("-", "_"): value for name, value in headers.items()}) == "websocket.close"
    assert client.websocket(origin="http://127.0.0.1:8080") == "reached"


def test_a_link_of_another_site_may_open_the_page_but_not_frame_it(dashboard) -> None:
    client = Browser(dashboard, Sessions(None))
    link = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    answer = client.get("/live.json", headers=link)
    assert answer.status_code == 200
    assert answer.headers["x-frame-options"] == "SAMEORIGIN"


@pytest.mark.parametrize(
    "name", ["..%2faudit.jsonl", "..%2f..%2fetc", "%2fetc", "results%2f..%2f..%2fx", "a/b/c", ".page", "x%00y", "%2e%2e"]
)
def test_no_path_leads_out_of_the_recordings(dashboard, name: str) -> None:
    client = Browser(dashboard, Sessions(None))
    answer = client.get(f"/download/bag/{name}")
    assert answer.status_code == 404
    with pytest.raises(InputError, match="no recording"):
        dashboard.recordings.find(unquote(name))


def test_a_recording_is_downloaded(dashboard, new_bag) -> None:
    new_bag(dashboard.recordings.folder / "sine-1")
    answer = Browser(dashboard, Sessions(None)).get("/download/bag/sine-1")
    assert answer.status_code == 200
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert "sine-1/metadata.yaml" in archive.namelist()


# Control


def test_one_operator_holds_control() -> None:
    clock = Clock()
    right = ControlRight(clock)
    right.take("a", "Ann")
    with pytest.raises(InputError, match="Ann holds control"):
        right.take("b", "Bob")
    with pytest.raises(InputError, match="Ann holds control"):
        right.require("b")
    right.release("b")
    assert right.holds("a")
    right.release("a")
    right.take("b", "Bob")
    assert right.holds("b")


def test_control_is_free_once_the_page_of_its_holder_is_closed() -> None:
    clock = Clock()
    right = ControlRight(clock)
    right.take("a", "Ann")
    clock.now += ABSENCE - 1
    right.seen("a")
    clock.now += ABSENCE - 1
    assert right.holds("a")
    clock.now += 2
    right.take("b", "Bob")
    assert not right.holds("a")


def test_nobody_is_no_session() -> None:
    assert not ControlRight().holds("")
