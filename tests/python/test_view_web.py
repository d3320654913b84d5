"""The page that `lidar-core view --web` serves, looked at with Chromium that has no display."""

import base64
import io
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from importlib.util import find_spec

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from lidar_core.cli import app

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE_S = 180
ORANGE = (255, 90, 25)  # of objects and their numbers
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; on Debian: apt install chromium"),
    pytest.mark.skipif(
        find_spec("rerun") is None and not os.environ.get("CI"), reason="rerun-sdk not installed"
    ),
]


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


@contextmanager
def running(command, **more):
    process = subprocess.Popen(command, **more)
    try:
        yield process
    finally:
        process.send_signal(2)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def address_of(viewer, log):
    """What the viewer prints once it serves; it listens on 127.0.0.1 alone."""
    while viewer.poll() is None:
        found = re.search(r"connect at (http://127\.0\.0\.1:\S+)", log.read_text())
        if found:
            return re.sub(r"\x1b\[\d+m", "", found[1]).replace("localhost", "127.0.0.1")
        time.sleep(0.2)
    raise AssertionError(f"the viewer ended: {log.read_text()}")


class Page:
    """One page of a browser, by Chrome's DevTools protocol."""

    def __init__(self, port):
        import websocket

        until = time.monotonic() + 60
        while True:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                    pages = [page for page in json.load(answer) if page["type"] == "page"]
                break
            except OSError:
                assert time.monotonic() < until, "Chromium does not start"
                time.sleep(0.5)
        self.socket = websocket.create_connection(pages[0]["webSocketDebuggerUrl"], timeout=120)
        self.number = 0

    def call(self, method, **parameters):
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while (answer := json.loads(self.socket.recv())).get("id") != self.number:
            pass
        return answer["result"]

    def picture(self):
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def test_the_page_shows_objects(tmp_path):
    source, run = tmp_path / "a.npz", tmp_path / "run"
    for command in (["simulate", "circles", "-o", source, "--scans", 20],
                    ["circles", source, "-o", run]):  # fmt: skip
        assert CliRunner().invoke(app, list(map(str, command))).exit_code == 0
    program = "from lidar_core.cli import main; main()"
    serve = [sys.executable, "-c", program, "view", str(run), "--web", "--port", str(free_port())]
    debug = free_port()
    browse = [CHROMIUM, "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
              "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--window-size=1280,800",
              f"--user-data-dir={tmp_path / 'browser'}", f"--remote-debugging-port={debug}",
              "--remote-allow-origins=*", "about:blank"]  # fmt: skip
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    log = tmp_path / "viewer.log"
    with (
        log.open("w") as told,
        running(serve, stdout=told, stderr=told) as viewer,
        running(browse, **quiet),
    ):
        address = address_of(viewer, log)
        page = Page(debug)
        page.call("Page.navigate", url=address)
        until, shown = time.monotonic() + PATIENCE_S, 0
        while shown < 100 and time.monotonic() < until:
            time.sleep(2)
            shown = int((np.abs(page.picture() - ORANGE).max(axis=2) < 30).sum())
        page.socket.close()
    assert shown >= 100
