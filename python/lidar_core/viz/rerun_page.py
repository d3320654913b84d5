"""Rerun's viewer in the browser, served by this process alone, without access to the network.

The page that rerun serves reports usage to its makers and loads fonts from elsewhere. This page
takes only the script and the WebAssembly module of the installed rerun-sdk, and a
Content-Security-Policy forbids the browser every request but those to the server that the page
came from.
"""

import subprocess
import time
import urllib.error
import urllib.request
import webbrowser
from functools import cache, partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from threading import Thread
from typing import Any

from lidar_core.errors import InternalError, LinkError
from lidar_core.viz.origin_check import LOCAL, refusal
from lidar_core.viz.rerun_feed import Feed
from lidar_core.viz.rerun_process import free_port, has_display, rerun_process

PAGE_PORT, LAST_PORT = 9090, 65535
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "connect-src 'self'",
        "img-src 'self' data: blob:",
        "style-src 'unsafe-inline'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""What the browser may load: scripts and data of this server, and nothing of any other one."""
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-DNS-Prefetch-Control": "off",
    "Cache-Control": "no-store",
}
OWN = {"/": ("index.html", "text/html; charset=utf-8"), "/page.js": ("page.js", "text/javascript")}
RERUNS = {"/re_viewer.js": "text/javascript", "/re_viewer_bg.wasm": "application/wasm"}
RECORDING = "/recording.rrd"
PATIENCE_S = 60.0  # for rerun's program to serve its files
IDLE_S = 30.0  # after which a connection that asks for nothing is closed


class RerunPage:
    """Serves rerun's viewer and one recording on 127.0.0.1 until it is closed.

    Requests for another host than this machine, and those of other web pages, are refused.

    Parameters
    ----------
    feed : callable
        Gives the recording.
    port : int
        Port of the page; 0 selects a free one.
    option : str
        Text before the port on the command line, such as "--port ", for error messages.

    Attributes
    ----------
    address : str
        Address to open in the browser.

    Raises
    ------
    LinkError
        The port is in use.
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self, feed: Feed, *, port: int = PAGE_PORT, option: str = "--port ") -> None:
        viewer = viewer_files()
        try:
            self._server = _Server((LOCAL, port), partial(_Handler, feed=feed, viewer=viewer))
        except OSError as error:
            raise LinkError(
                f"rerun's page: port {port} cannot be opened ({error}); stop the program that"
                f" uses it, or choose another port: {option}{port + 1 if port < LAST_PORT else 0}"
            ) from error
        self.address = f"http://{LOCAL}:{self._server.server_port}"
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; connections that are open end with the process."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def open_browser(address: str) -> None:
    """Open a page in the user's browser; nothing happens on a machine without a display."""
    if has_display():
        webbrowser.open(address)


@cache
def viewer_files() -> dict[str, bytes]:
    """Return script and WebAssembly module of rerun's viewer, from its own server.

    They are part of rerun's program, which runs only as long as necessary.
    """
    port = free_port()
    # With an address to look at, rerun opens no other server than that of its page.
    unused = f"http://{LOCAL}:{port}/none.rrd"
    with rerun_process(
        [unused, "--serve-web", "--web-viewer-port", str(port)], quiet=True
    ) as rerun:
        return {name: _fetch(f"http://{LOCAL}:{port}{name}", rerun) for name in RERUNS}


def _fetch(address: str, server: "subprocess.Popen[bytes]") -> bytes:
    until = time.monotonic() + PATIENCE_S
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while server.poll() is None and time.monotonic() < until:
        try:
            with direct.open(address, timeout=PATIENCE_S) as answer:
                return bytes(answer.read())
        except urllib.error.HTTPError:
            break
        except OSError:
            time.sleep(0.05)
    name = address.rpartition("/")[2]
    raise InternalError(
        f"rerun-sdk: its program gave no {name}; `lidar-core view RUN --rrd FILE`"
        " writes a file that rerun's window opens"
    )


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 16


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD for the few files of the page."""

    timeout = IDLE_S

    def __init__(self, *request: Any, feed: Feed, viewer: dict[str, bytes]) -> None:
        self._feed, self._viewer = feed, viewer
        super().__init__(*request)

    def do_GET(self) -> None:
        """Send a file of the page, or the recording."""
        path = self.path.partition("?")[0]
        reason = refusal(self.headers.get_all("Host", []), self.headers.get_all("Origin", []))
        if reason is not None:
            self._send(HTTPStatus.FORBIDDEN, "text/plain", f"refused: {reason}\n".encode())
        elif path in OWN:
            name, kind = OWN[path]
            self._send(HTTPStatus.OK, kind, (files(__package__) / "page" / name).read_bytes())
        elif path in RERUNS:
            self._send(HTTPStatus.OK, RERUNS[path], self._viewer[path])
        elif path == RECORDING:
            self._stream()
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"no such file\n")

    def do_HEAD(self) -> None:
        """Send the headers alone."""
        self.do_GET()

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._begin(status, kind, {"Content-Length": str(len(content))})
        if self.command != "HEAD":
            self.wfile.write(content)

    def _stream(self) -> None:
        """Send the recording; its end is that of the connection."""
        self._begin(HTTPStatus.OK, "application/octet-stream", {})
        if self.command == "HEAD":
            return
        try:
            for block in self._feed():
                self.wfile.write(block)
        except OSError:
            return  # the page was closed

    def _begin(self, status: HTTPStatus, kind: str, more: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, **more, "Content-Type": kind}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        """Print nothing on the console."""
