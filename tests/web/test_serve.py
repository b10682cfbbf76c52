"""The page's server: what it refuses, what it answers, and one whole way through it in a browser."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

uvicorn = pytest.importorskip("uvicorn", reason="the extra [web] is not installed: pip install '.[web]'")
pytest.importorskip("starlette", reason="the extra [web] is not installed: pip install '.[web]'")

from twin.cli.main import main  # noqa: E402
from twin.web import app  # noqa: E402

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


def log_text(seconds: float = 6.0, sign: float = 1.0) -> str:
    """A recording of an axis with inertia, viscous and dry friction, integrated in small steps."""
    step, rng = 0.002, np.random.default_rng(5)
    duty = rng.uniform(-60.0, 60.0, int(seconds / 0.3) + 1).repeat(150)[: int(seconds / step)]
    speed, angle, rows = 0.0, 0.0, ["t,duty,counts"]
    for i, u in enumerate(duty):
        rows.append(f"{i * step:.3f},{u:.1f},{round(sign * angle * 4096 / (2 * np.pi))}")
        for _ in range(10):
            drive = 0.4 * u - 1.5 * speed
            slowed = drive - 2.0 * np.sign(speed) if speed else np.sign(drive) * max(abs(drive) - 2.0, 0.0)
            after = speed + 0.1 * step * slowed
            speed = 0.0 if after * speed < 0.0 else after
            angle += 0.1 * step * speed
    return "\n".join(rows)


@dataclass(frozen=True)
class Answer:
    status: int
    headers: Mapping[str, str]
    text: str

    @property
    def told(self) -> Any:
        return json.loads(self.text)


class Client:
    """A server in a thread, and requests to it over a socket, with any headers."""

    def __init__(self) -> None:
        self.socket = app.listen(0)
        self.port = self.socket.getsockname()[1]
        self.own = {"origin": f"http://127.0.0.1:{self.port}"}
        self.server = uvicorn.Server(uvicorn.Config(app.make_app(), log_level="warning"))
        self.thread = threading.Thread(target=self.server.run, args=([self.socket],))
        self.thread.start()

    def close(self) -> None:
        self.server.should_exit = True
        self.thread.join(20)
        self.socket.close()

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, None, headers)

    def post(self, path: str, body: Any = b"", headers: Mapping[str, str] | None = None) -> Answer:
        body = json.dumps(body) if isinstance(body, dict) else body
        return self.ask("POST", path, body, self.own if headers is None else headers)

    def ask(self, method: str, path: str, body: Any, headers: Mapping[str, str]) -> Answer:
        with closing(HTTPConnection("127.0.0.1", self.port, timeout=60)) as line:
            line.request(method, path, body, dict(headers))
            answer = line.getresponse()
            return Answer(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read().decode())

    def drop(self, content: str | bytes, name: str = "axis.csv") -> Answer:
        return self.post(f"/log?name={quote(name, safe='')}", content)

    def choose(self, sections: Mapping[str, Any]) -> Any:
        return self.post("/rig", dict(sections)).told


def keys(looked: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of the rig file that a look gave."""
    return {title: dict(table["keys"]) for title, table in looked["sections"].items()}


@pytest.fixture
def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """A server whose folders lie in `tmp_path`, which it leaves empty."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    made = Client()
    yield made
    made.close()
    assert list(tmp_path.iterdir()) == []


def test_pages_hold_no_address_elsewhere_and_a_policy_that_lets_nothing_in(client: Client) -> None:
    for path in ("/", "/page.js", "/page.css", "/result.js", "/explorer.js", "/report.css"):
        answer = client.get(path)
        assert answer.status == 200
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert not re.search(r"(src|href)=.?(https?:)?//|url\(|import ", answer.text)


def test_a_name_that_is_rebound_to_this_machine_is_refused(client: Client) -> None:
    for host in ("attacker.example", "127.0.0.1.attacker.example", f"attacker.example:{client.port}"):
        assert client.get("/state", host=host).status == 400
        assert client.post("/search", b"{}", {"host": host, "origin": f"http://{host}"}).status == 400
    assert client.get("/state", host=f"localhost:{client.port}").status == 200


@pytest.mark.parametrize("origin", [None, "null", "http://attacker.example", "http://127.0.0.1:9", "https://127.0.0.1"])
def test_what_another_page_sends_is_refused(client: Client, origin: str | None) -> None:
    for path in ("/log?name=a.csv", "/rig", "/search", "/stop", "/simulate"):
        assert client.post(path, b"{}", {} if origin is None else {"origin": origin}).status == 403
    assert client.get("/state").told == {"state": "empty"}


def test_a_log_is_looked_at_and_what_is_chosen_is_saved(client: Client, tmp_path: Path) -> None:
    looked = client.drop(log_text()).told
    assert looked["columns"] == ["t", "duty", "counts"]
    assert keys(looked)["input"] == {"column": "duty", "unit": "%"}
    assert looked["problem"] == "" and len(looked["panels"]["panels"]) == 2
    assert any("counts_per_revolution" in u for u in looked["unsure"])
    chosen = client.choose({**keys(looked), "output": {**keys(looked)["output"], "counts_per_revolution": 10_000}})
    assert "counts_per_revolution = 10000" in chosen["text"]
    # A page that is opened again does not doubt what was set.
    assert client.get("/state").told["looked"]["unsure"] == []
    assert client.get("/files/rig.toml").text == chosen["text"]
    (folder,) = tmp_path.iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    for hostile in HOSTILE:
        answer = client.post("/rig", json.dumps(hostile))
        assert answer.status == 400 and answer.told["problem"]
    assert client.get("/files/rig.toml").text == chosen["text"]
    for path in ("/files/../rig.toml", "/files/..%2f..%2fetc%2fpasswd", "/files/recording.csv", "/files/report.html"):
        assert client.get(path).status == 404
    for path in ("/simulate", "/stop"):
        assert client.post(path, {}).status == 400
    assert "no result yet" in client.get("/result").told["problem"]


#: What a page other than ours might say of the columns: other files, other tables, TOML in a key, no tables.
HOSTILE = [
    {"input": {"column": "duty", "unit": "%", "file": "/etc/passwd"}},
    {"loop": {"reference": "x"}},
    {"input": {'column = "duty"\n[known]\nx': 1}},
    {"input": {"column": ["duty"]}},
    {"input": {"full_scale": float("inf")}},
    {"input": 5},
    [1],
]


def test_what_the_checks_find_is_said_and_stops_the_search(client: Client) -> None:
    looked = client.drop(log_text(12.0, sign=-1.0)).told
    sections = keys(looked)
    assert sections["output"].pop("scale") == -1
    chosen = client.choose(sections)
    assert "moves against the input" in chosen["problem"]
    assert client.post("/search", {}).told["problem"] == chosen["problem"]


def test_columns_that_no_name_tells_are_chosen_by_hand(client: Client) -> None:
    looked = client.drop(log_text().replace("t,duty,counts", "a,goal,c")).told
    assert "choose the column" in looked["problem"] and len(looked["panels"]["panels"]) == 3
    output = {"column": "c", "unit": "count", "counts_per_revolution": 4096}
    chosen = client.choose({"time": {"column": "a"}, "input": {"column": "goal", "unit": "%"}, "output": output})
    assert chosen["problem"] == "" and "6.0 s at 2 ms" in chosen["says"]
    # A choice that does not load still shows the columns as they are.
    chosen = client.choose(
        {"time": {"column": "c"}, "input": {"column": "goal", "unit": "%"}, "output": {"column": "a"}}
    )
    assert chosen["problem"] and len(chosen["panels"]["stretches"]) == 1


def test_what_is_no_recording_is_refused_in_one_sentence(client: Client) -> None:
    cases: list[tuple[str | bytes, str, str]] = [
        ("", "axis.csv", "axis.csv"),
        (b"\x00\x01\x02" * 50, "axis.mat", "axis.mat"),
        (gzip.compress(b"t,duty,counts\n1,2")[:-9], "axis.csv.gz", "damaged gzip"),
        ("a,b", "axis.exe", "no recording by its ending"),
        ("file\n/etc/passwd", "../../list.csv", "list of recordings"),
        ("file\nelsewhere.csv", "list.csv", "list of recordings"),
    ]
    for content, name, says in cases:
        answer = client.drop(content, name)
        problem = answer.told["problem"]
        assert answer.status == 400 and says in problem
        assert not re.search(r"\n|twin-|Traceback|\.\.", problem)


def test_the_name_of_a_log_leads_nowhere(client: Client, tmp_path: Path) -> None:
    for name in ("../../evil.csv", f"..\\{tmp_path}/evil.csv"):
        assert client.drop(log_text(), name).told["name"] == "evil.csv"
    assert not [p for p in tmp_path.rglob("*") if "evil" in p.name]
    assert len(list(tmp_path.iterdir())) == 1  # the folder of the last log alone


def test_a_log_that_is_too_large_is_refused(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MAX_LOG", 1000)
    without_length = iter([b"1,2,3\n" * 50] * 10)
    for content in (log_text(1.0), without_length):
        answer = client.post("/log?name=axis.csv", content)
        assert answer.status == 413 and "larger than" in answer.told["problem"]
    assert client.get("/state").told == {"state": "empty"}


def test_a_port_that_is_taken_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    with app.listen(0) as taken:
        port = taken.getsockname()[1]
        assert main(["serve", "--port", str(port)]) == 2
    assert f"port {port} cannot be used" in capsys.readouterr().err
    assert main(["serve", "--port", "70000"]) == 2


def test_a_missing_extra_is_named_with_the_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "twin.web.app")
    monkeypatch.delattr("twin.web.app")
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["serve"]) == 2
    said = capsys.readouterr().err
    assert "[web]" in said and "uvicorn" in said and "pip install" in said and said.count("\n") == 1


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server as a user starts it; its end leaves nothing behind."""
    place = tmp_path_factory.mktemp("uploads")
    command = [sys.executable, "-m", "twin", "serve", "--port", "0"]
    environment = {**os.environ, "TMPDIR": str(place)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        yield line.split()[1]
        server.send_signal(signal.SIGINT)
        assert server.wait(20) == 0
    assert list(place.glob("twin-*")) == []


@pytest.fixture(scope="module")
def page(address: str) -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("Chromium is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=BROWSER, args=FLAGS)
        shown = browser.new_page(viewport={"width": 390, "height": 844})
        shown.said, shown.asked = [], []
        shown.on("console", lambda message: shown.said.append(message.text))
        shown.on("pageerror", lambda error: shown.said.append(str(error)))
        shown.on("request", lambda request: shown.asked.append(request.url))
        shown.goto(address)
        yield shown
        browser.close()


def no_sideways_scrolling(page: Any) -> bool:
    return bool(page.evaluate("document.documentElement.scrollWidth <= 390"))


def test_from_a_dropped_log_to_a_model_on_sliders(page: Any, address: str, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    log = tmp_path / "bench.csv"
    log.write_text(log_text(5.0))
    assert no_sideways_scrolling(page)
    page.set_input_files("#file", log)
    page.get_by_label("counts per revolution").fill("4000")
    page.get_by_label("counts per revolution").press("Tab")
    expect(page.locator("#rig")).to_contain_text("= 4000")
    page.wait_for_selector("#preview[data-ready=yes]")
    assert no_sideways_scrolling(page)
    page.get_by_role("button", name="Search for what is missing").click()
    page.wait_for_selector("#models li", timeout=300_000)
    assert no_sideways_scrolling(page)
    # Ended early: the first model is there already.
    page.get_by_role("button", name="Stop, with the best model so far").click()
    page.wait_for_url("**/result", timeout=300_000)
    page.wait_for_selector("#explorer[data-ready=yes]")
    assert "stopped" in page.locator("h1").inner_text()
    picture = page.locator("#explorer canvas").first.screenshot()
    slider = page.locator(".try input[type=range]").first
    slider.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    expect(page.locator(".try .now")).to_contain_text("With these parameters")
    time.sleep(0.3)  # the panels are drawn
    assert page.locator("#explorer canvas").first.screenshot() != picture
    with page.expect_download() as kept:
        page.get_by_role("link", name="FMU", exact=True).click()
    assert kept.value.path().stat().st_size > 1000
    assert no_sideways_scrolling(page)
    assert page.said == []
    assert all(url.startswith((address, "data:", "blob:")) for url in page.asked)
