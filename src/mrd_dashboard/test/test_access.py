"""Who may open the page, and who may command the bench."""

import asyncio
import hashlib
import io
import json
import math
import socket
import subprocess
import sys
import zipfile
from pathlib import Path
from urllib.parse import unquote

import httpx
import numpy as np
import pytest

from mrd_base import InputError
from mrd_dashboard.access import (
    MOST_FAILURES,
    PAUSE,
    SESSION_TIME,
    Credentials,
    Sessions,
    Token,
    hash_password,
    password_matches,
    read_credentials,
    require_safe_host,
    write_credentials,
)
from mrd_dashboard.audit import REPEATED_AFTER
from mrd_dashboard.control_right import ABSENCE, ControlRight
from mrd_dashboard.server import server_config
from mrd_dashboard.web import guarded, make_app

PASSWORD = "slow damper 7"
PAGE = {"accept": "text/html"}
FOREIGN = [
    {"origin": "http://evil.example"},
    {"origin": "http://127.0.0.1:9999"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site"},
    {"host": "evil.example:8080"},  # by a name that leads to this machine
]
"""Headers that a browser sends for another site."""


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def credentials() -> Credentials:
    return Credentials(hash_password(PASSWORD))


class Browser:
    """Keeps cookies, and does not follow redirections."""

    def __init__(self, dashboard, sessions: Sessions, host: str = "127.0.0.1", names: str = "") -> None:
        self.app = guarded(make_app(dashboard, sessions), sessions, host, 8080, dashboard.audit, names)
        self.cookies = httpx.Cookies()
        self.address = "10.0.0.1"

    def request(self, method: str, path: str, **options) -> httpx.Response:
        async def send() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, client=(self.address, 1))
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

    def websocket(self, hears: int = 0, meanwhile=lambda: None, path: str = "/_nicegui_ws/socket.io", **headers: str) -> str:
        """Return the type of the first answer to a websocket.

        If it is let in, the application hears a number of messages, before the last of which something happens.
        """
        cookies = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        sent = {
            "host": "127.0.0.1:8080",
            "cookie": cookies,
            **{key.replace("_", "-"): value for key, value in headers.items()},
        }
        scope = {
            "type": "websocket",
            "client": (self.address, 1),
            "path": path,
            "headers": [(name.encode(), value.encode()) for name, value in sent.items()],
            "query_string": b"",
            "subprotocols": [],
        }
        answers = []

        async def receive():
            return {"type": "websocket.receive", "text": "a command"}

        async def send(message) -> None:
            answers.append(message["type"])

        reached = []

        async def behind(scope, receive, send) -> None:
            reached.append("reached")
            for left in range(hears, 0, -1):
                if left == 1:
                    meanwhile()
                reached.append((await receive())["type"])

        guard, self.app._app = self.app._app, behind
        asyncio.run(self.app(scope, receive, send))
        self.app._app = guard
        return reached[-1] if reached else answers[0]


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
    assert stored.valid_until(PASSWORD) == math.inf
    assert stored.valid_until(token) == stored.tokens[0].expires
    assert stored.valid_until(token + "x") == -math.inf


def test_a_session_ends_with_the_token_that_opened_it() -> None:
    clock = Clock()
    sessions = Sessions(Credentials(tokens=(Token(hashlib.sha256(b"key").hexdigest(), clock.now + 60.0),)), clock)
    session = sessions.open("key")
    clock.now += 59.0
    assert sessions.is_open(session)
    clock.now += 2.0
    assert not sessions.is_open(session)
    with pytest.raises(InputError, match="has expired"):
        sessions.open("key")


@pytest.mark.parametrize("secret", ["", PASSWORD])
def test_no_visit_ends_the_session_of_another(credentials: Credentials, secret: str, monkeypatch) -> None:
    monkeypatch.setattr("mrd_dashboard.access.password_matches", lambda _stored, password: password == PASSWORD)
    sessions = Sessions(credentials if secret else None)
    operator = sessions.open(secret)
    opened = {sessions.open(secret) for _ in range(2000)}
    assert len(opened) == 2000
    assert sessions.is_open(operator)
    assert all(map(sessions.is_open, opened))


def test_a_session_cannot_be_made_up(credentials: Credentials) -> None:
    sessions = Sessions(credentials)
    session = sessions.open(PASSWORD)
    content, _, signature = session.rpartition(".")
    longer = content.replace(content.rpartition(".")[2], "inf")
    for made_up in ("", ".", "..", "x", f"{longer}.{signature}", f"{content}.", session[:-1], f"{session}é", f".{session}"):
        assert not sessions.is_open(made_up), made_up
    assert not Sessions(credentials).is_open(session), "a server that was started again knows none"
    assert sessions.is_open(session)
    sessions.close("x")
    sessions.close(session)
    assert not sessions.is_open(session)


def test_a_session_ends(credentials: Credentials) -> None:
    clock = Clock()
    sessions = Sessions(credentials, clock)
    session = sessions.open(PASSWORD)
    clock.now += SESSION_TIME - 1
    assert sessions.is_open(session)
    clock.now += 2
    assert not sessions.is_open(session)


def test_guessing_is_slowed_down_for_who_guesses(credentials: Credentials) -> None:
    clock = Clock()
    sessions = Sessions(credentials, clock)
    for _ in range(MOST_FAILURES):
        with pytest.raises(InputError, match="wrong"):
            sessions.open("wrong password", "10.0.0.66")
    with pytest.raises(InputError, match="too many"):
        sessions.open(PASSWORD, "10.0.0.66")
    assert sessions.open(PASSWORD, "10.0.0.1")
    clock.now += PAUSE + 1
    assert sessions.open(PASSWORD, "10.0.0.66")


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
        ("request", "refused"),
        ("login", "refused"),
        ("login", "done"),
        ("logout", "done"),
    ]
    assert PASSWORD not in dashboard.audit.path.read_text()


def test_a_sample_that_is_no_number_is_null_in_the_live_frame(dashboard) -> None:
    dashboard.bench.samples.add(0, 1.0, 1e-3, np.zeros(8), np.array([*range(7), np.nan]), np.zeros(8))
    answer = Browser(dashboard, Sessions(None)).get("/live.json")
    assert answer.headers["content-type"] == "application/json"
    assert answer.json()["force_N"][-2:] == [6.0, None]


@pytest.mark.parametrize(("path", "part"), [("/live.json", "live_frame"), ("/hybrid.json", "hybrid_frame")])
def test_a_frame_that_cannot_be_computed_says_why(dashboard, monkeypatch, path: str, part: str) -> None:
    def fail(*_) -> None:
        raise ZeroDivisionError("no speed")

    module = "dashboard" if part == "live_frame" else "web"
    client = Browser(dashboard, Sessions(None))
    with monkeypatch.context() as broken:
        broken.setattr(f"mrd_dashboard.{module}.{part}", fail)
        answer = client.get(path)
    assert (answer.status_code, answer.text) == (500, "ZeroDivisionError: no speed; please report this")
    assert client.get(path).status_code == 200


def test_on_this_machine_every_browser_gets_a_session(dashboard) -> None:
    client = Browser(dashboard, Sessions(None))
    assert client.get("/live.json").status_code == 200
    assert not client.cookies, "a program that only reads has no session, and must not use them up"
    assert client.websocket() == "websocket.close"
    assert client.get("/session").status_code == 401
    client.get("/", headers=PAGE)
    assert client.cookies
    assert client.websocket() == "reached"
    assert client.get("/session").status_code == 204


def test_an_open_page_cannot_command_after_logout(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    client.post("/login", data={"secret": PASSWORD})
    assert client.websocket(hears=2) == "websocket.receive"
    assert client.websocket(hears=2, meanwhile=lambda: client.app._sessions.close(session_of(client))) == (
        "websocket.disconnect"
    )


def session_of(client: Browser) -> str:
    return dict(client.cookies.items())[client.app.cookie]


def test_stop_is_asked_for_by_a_plain_request(dashboard, commands, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    assert client.get("/stop").status_code == 405
    for headers in FOREIGN[:-1]:
        assert client.post("/stop", headers=headers).status_code == 403
    assert commands.asked == []
    assert client.post("/stop", headers={"origin": "http://127.0.0.1:8080", "sec-fetch-site": "same-origin"}).is_success
    assert commands.asked == ["emergency stop"]


def test_the_login_has_a_stop_that_needs_no_session(dashboard, commands, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    assert "mrd-stop" in client.get("/login").text
    assert "mrd-stop" in client.post("/login", data={"secret": "wrong password"}).text
    for _ in range(20):
        assert client.post("/stop", headers={"origin": "http://127.0.0.1:8080"}).status_code == 204
    assert commands.asked == ["emergency stop"] * 20
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [entry["result"] for entry in log if entry["action"] == "emergency stop"] == ["requested without a session"]
    assert client.websocket(path="/stop") == "websocket.close"
    client.post("/login", data={"secret": PASSWORD})
    client.app._sessions.close(session_of(client))
    assert client.post("/stop").status_code == 204, "a page whose session has ended stops, too"


def test_behind_a_proxy_the_page_has_the_name_of_the_proxy(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials), names="bench.example other.example")
    name = {"host": "bench.example", "origin": "https://bench.example"}
    assert client.post("/login", data={"secret": PASSWORD}, headers=name).status_code == 303
    assert client.post("/login", data={"secret": PASSWORD}, headers={**name, "origin": "https://x"}).status_code == 403


def test_with_a_login_too_a_name_that_is_not_of_the_bench_reaches_nothing(
    dashboard, commands, credentials: Credentials
) -> None:
    client = Browser(dashboard, Sessions(credentials), host="0.0.0.0")
    for host in ("evil.example:8080", "evil.example", "1.2.3.4.evil.example:8080", "[::1].evil.example", ""):
        answer = client.post("/stop", headers={"host": host, "origin": f"http://{host}"})
        assert answer.status_code == 403
        assert "the parameter names" in answer.text
    assert commands.asked == []
    machine = socket.gethostname()
    for host in ("192.0.2.7:8080", "[2001:db8::7]:8080", "[::1]", "localhost:8080", machine, f"{machine.upper()}.local:80"):
        assert client.post("/stop", headers={"host": host, "origin": f"http://{host}"}).status_code == 204, host


def test_refused_requests_are_logged_but_do_not_fill_the_disk(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    for number in range(20):
        client.get("/live.json")
        client.get("/live.json", headers={"origin": f"http://{number}.example"})
    client.address = "10.0.0.2"
    client.get("/live.json")
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [(entry["who"], entry["detail"], entry["result"][:30]) for entry in log] == [
        ("10.0.0.1", "/live.json", "refused: not logged in"),
        ("10.0.0.1", "/live.json", "refused: the request comes fro"),
        ("10.0.0.2", "/live.json", "refused: not logged in"),
    ]


def test_refused_logins_are_counted_but_do_not_fill_the_disk(dashboard, credentials: Credentials) -> None:
    clock = dashboard.audit._clock = Clock()
    client = Browser(dashboard, Sessions(credentials))
    for _ in range(100):
        assert client.post("/login", data={"secret": "wrong password"}).status_code == 401
    assert len(dashboard.audit.path.read_text().splitlines()) == 1
    client.address = "10.0.0.2"
    clock.now += REPEATED_AFTER
    client.post("/login", data={"secret": "wrong password"})
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [(entry["who"], entry["action"], entry["result"].partition(" p")[0]) for entry in log] == [
        ("10.0.0.1", "login", "refused: wrong"),
        ("10.0.0.1", "login", "99 more like it within 60 s"),
        ("10.0.0.2", "login", "refused: wrong"),
    ]


def test_no_header_avoids_the_pause_after_wrong_passwords(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    config = server_config(client.app, "127.0.0.1", 8080)
    config.load()
    client.app, client.address = config.loaded_app, "127.0.0.1"
    for number in range(MOST_FAILURES + 1):
        headers = {"x-forwarded-for": f"10.0.0.{number}", "forwarded": f"for=10.0.0.{number}"}
        answer = client.post("/login", data={"secret": "wrong password"}, headers=headers)
    assert "too many wrong passwords" in answer.text
    assert len(dashboard.audit.path.read_text().splitlines()) == 1


def test_the_audit_log_names_who_comes_through_a_proxy(dashboard, credentials: Credentials) -> None:
    client = Browser(dashboard, Sessions(credentials))
    proxy = {"x-forwarded-for": "192.0.2.7", "x-forwarded-proto": "https"}
    answer = client.post("/login", data={"secret": PASSWORD}, headers=proxy)
    assert "; Secure" in answer.headers["set-cookie"]
    (entry,) = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert entry["who"].startswith("10.0.0.1 for 192.0.2.7 (")


@pytest.mark.parametrize("headers", FOREIGN)
def test_requests_of_other_sites_are_refused(dashboard, headers) -> None:
    client = Browser(dashboard, Sessions(None))
    client.get("/", headers=PAGE)
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
    (entry,) = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert (entry["action"], entry["detail"], entry["result"]) == ("download", "bag sine-1", "sent")


def test_a_sheet_is_shown_in_a_sandbox_and_downloaded(dashboard) -> None:
    folder = dashboard.dampers.folder / "SN-1/reports"
    folder.mkdir(parents=True)
    (folder / "sheet.html").write_text("<!doctype html><p>sheet")
    (folder / "sheet.pdf").write_bytes(b"%PDF")
    client = Browser(dashboard, Sessions(None))
    page = client.get("/test/sheet.html/SN-1/reports")
    assert (page.status_code, page.headers["content-security-policy"]) == (200, "sandbox allow-scripts")
    pdf = client.get("/test/sheet.pdf/SN-1/reports")
    assert pdf.content == b"%PDF"
    assert 'filename="SN-1-reports-sheet.pdf"' in pdf.headers["content-disposition"]
    entries = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [(entry["action"], entry["result"]) for entry in entries] == [("report", "sent")] * 2


@pytest.mark.parametrize(
    "path",
    [
        "sheet.pdf/SN-1/..%2f..%2f..%2foutside",
        "sheet.pdf/%2e%2e/outside",
        "sheet.pdf/link",
        "sheet.pdf/x%00y",
        "audit.jsonl/SN-1",
        "sheet.html/SN-1",
    ],
)
def test_nothing_but_the_files_of_tests_is_served(dashboard, path: str) -> None:
    runs = dashboard.dampers.folder
    for folder in (runs, runs / "SN-1", runs.parent / "outside"):
        folder.mkdir(exist_ok=True)
        (folder / "sheet.pdf").write_bytes(b"%PDF")
    (runs / "SN-1/audit.jsonl").touch()
    (runs / "link").symlink_to(runs.parent / "outside")
    client = Browser(dashboard, Sessions(None))
    assert client.get("/test/sheet.pdf/SN-1").status_code == 200
    assert client.get(f"/test/{path}").status_code == 404
    name, _, test = path.partition("/")
    with pytest.raises(InputError, match="no test below"):
        dashboard.dampers.file(unquote(test), name)


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
