"""Chromium without a display, by its DevTools protocol, and the list of all that it asked for."""

import base64
import io
import json
import shutil
import socket
import subprocess
import time
import urllib.request
from urllib.parse import urlsplit

import numpy as np
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NOWHERE = "http://127.0.0.1:9/"  # where the browser's own services are sent to
# No name is looked up, so nothing leaves this machine; what was asked for is listed all the same.
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--window-size=1280,800",
    "--remote-allow-origins=*",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    "--no-first-run",
    "--no-pings",
    "--no-service-autorun",
    "--disable-background-networking",
    "--disable-client-side-phishing-detection",
    "--disable-component-update",
    "--disable-component-extensions-with-background-pages",
    "--disable-default-apps",
    "--disable-domain-reliability",
    "--disable-extensions",
    "--disable-sync",
    "--disable-features=AutofillServerCommunication,MediaRouter,NetworkTimeServiceQuerying,"
    "OptimizationGuideModelDownloading,OptimizationHints,OptimizationHintsFetching,Translate",
    f"--gaia-url={NOWHERE}",
    f"--google-apis-url={NOWHERE}",
    f"--google-base-url={NOWHERE}",
    f"--gcm-checkin-url={NOWHERE}",
    f"--gcm-registration-url={NOWHERE}",
    f"--component-updater=url-source={NOWHERE}",
)


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


class Browser:
    """One page of a browser that notes every request; `with` ends it."""

    def __init__(self, folder):
        import websocket

        port, self._log, self._number = free_port(), folder / "net.json", 0
        self._process = subprocess.Popen(
            [
                CHROMIUM,
                *FLAGS,
                f"--user-data-dir={folder / 'profile'}",
                f"--log-net-log={self._log}",
                f"--remote-debugging-port={port}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until = time.monotonic() + 60
        while True:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                    pages = [page for page in json.load(answer) if page["type"] == "page"]
                break
            except OSError:
                assert time.monotonic() < until, "Chromium does not start"
                time.sleep(0.5)
        self._socket = websocket.create_connection(pages[0]["webSocketDebuggerUrl"], timeout=120)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._process.poll() is None:
            self.end()

    def call(self, method, **parameters):
        self._number += 1
        told = {"id": self._number, "method": method, "params": parameters}
        self._socket.send(json.dumps(told))
        while (answer := json.loads(self._socket.recv())).get("id") != self._number:
            pass
        return answer["result"]

    def open(self, address):
        self.call("Page.navigate", url=address)

    def value(self, expression):
        return self.call("Runtime.evaluate", expression=expression)["result"].get("value")

    def picture(self):
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def end(self):
        """Close the browser, so that its list is complete."""
        self.call("Browser.close")
        self._socket.close()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def addresses(self):
        """Every address that was asked for or connected to beforehand, by page or browser."""
        if self._process.poll() is None:
            self.end()
        events = json.loads(self._log.read_text())["events"]
        told = (event.get("params", {}) for event in events)
        return {params["url"] for params in told if "://" in str(params.get("url", ""))}

    def hosts(self):
        """Names of all hosts of `addresses`."""
        return {urlsplit(address).hostname for address in self.addresses()}
