"""State of a live run as text that Prometheus fetches.

Format: Prometheus text exposition format 0.0.4.
"""

from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread

from lidar_core.errors import LinkError
from lidar_core.live.stats import Delay, Report

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
PATH = "/metrics"
PREFIX = "lidar_core_live_"


def metrics_text(report: Report | None) -> str:
    """Return all metrics of a report as text; before the first report, only that the run exists."""
    return "\n".join([*_lines(report), ""])


def _lines(report: Report | None) -> Iterator[str]:
    yield from _metric("up", "gauge", "Whether the run is there.", {"": 1})
    if report is None:
        return
    yield from _metric("seconds", "counter", "Since the start of the run.", {"": report.elapsed_s})
    yield from _metric(
        "scans_total", "counter", "Scans that were processed.", {"": report.processed}
    )
    yield from _metric(
        "scans_left_out_total",
        "counter",
        "Scans that were not processed, by reason.",
        {f'{{reason="{what.replace(" ", "_")}"}}': n for what, n in report.counts.items()},
    )
    yield from _metric(
        "scan_rate_hertz", "gauge", "Scans per second since the last report.", {"": report.rate_hz}
    )
    yield from _metric("objects", "gauge", "Tracks or elements of the map.", {"": report.objects})
    delays = {"arrival": report.from_arrival, "stamp": report.from_stamp}
    values = {
        f'{{since="{since}",quantile="{quantile}"}}': milliseconds * 1e-3
        for since, delay in delays.items()
        if delay is not None
        for quantile, milliseconds in _quantiles(delay)
    }
    told = "From a scan's stamp or arrival to the end of the outputs, since the last report."
    yield from _metric("latency_seconds", "gauge", told, values)
    is_linked = int(not report.trouble)
    yield from _metric(
        "source_ok", "gauge", "Whether the source waits for nothing.", {"": is_linked}
    )


def _quantiles(delay: Delay) -> Iterator[tuple[str, float]]:
    yield "0.5", delay.median
    yield "0.95", delay.p95


def _metric(name: str, kind: str, told: str, values: dict[str, float]) -> Iterator[str]:
    yield f"# HELP {PREFIX}{name} {told}"
    yield f"# TYPE {PREFIX}{name} {kind}"
    for labels, value in values.items():
        yield f"{PREFIX}{name}{labels} {value:.9g}"


class MetricsServer:
    """Serves the newest report at /metrics.

    Parameters
    ----------
    host, port : str, int
        Address to listen at; port 0 selects a free one.

    Raises
    ------
    LinkError
        The port cannot be opened.

    Attributes
    ----------
    address : str
        URL of the metrics.
    """

    def __init__(self, host: str, port: int) -> None:
        self._report: Report | None = None
        self._lock = Lock()
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path != PATH:
                    self.send_error(404, f"metrics are at {PATH}")
                    return
                body = metrics_text(server.newest).encode()
                self.send_response(200)
                self.send_header("Content-Type", CONTENT_TYPE)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                return  # every scrape would be a line

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except (OSError, OverflowError) as error:
            raise LinkError(
                f"metrics: {host}:{port} cannot be opened ({error}); choose another port"
            ) from error
        self._server.daemon_threads = True
        self.address = f"http://{host}:{self._server.server_address[1]}{PATH}"
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def newest(self) -> Report | None:
        """Return the newest report."""
        with self._lock:
            return self._report

    def update(self, report: Report) -> None:
        """Update the metrics with a report."""
        with self._lock:
            self._report = report

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
