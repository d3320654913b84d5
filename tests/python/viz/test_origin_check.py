"""Who may talk to the servers on 127.0.0.1: no foreign page, no foreign name (DNS rebinding)."""

import contextlib
import http.client
import json
import socket
import struct
import subprocess
import sys
import time
from importlib.util import find_spec

import numpy as np
import pytest
from commands import running
from mcap.reader import make_reader
from typer.testing import CliRunner

import lidar_core as lc
from lidar_core.cli import app
from lidar_core.errors import ConfigError
from lidar_core.viz.foxglove_server import BACKLOG, FoxgloveServer, ServedLog
from lidar_core.viz.origin_check import allowed_origins, refusal

FOXGLOVE = "https://app.foxglove.dev"
PATIENCE_S = 60
needs_rerun = pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk is not installed")


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8765", "localhost:8765", "LOCALHOST", "[::1]:8765", "127.0.0.1:9"]
)
@pytest.mark.parametrize("origin", [None, "http://127.0.0.1:9090", "http://localhost", FOXGLOVE])
def test_programs_and_pages_that_may_connect(host, origin):
    assert refusal([host], [] if origin is None else [origin], {FOXGLOVE}) is None


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8765",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8765",
        "0.0.0.0:8765",
        "evil@127.0.0.1",
        "127.0.0.1/evil",
        "",
        "127.0.0.1:x",
        "[::1",
        "localhost#evil",
    ],
)
def test_a_foreign_host_is_refused_as_dns_rebinding(host):
    assert "this server accepts 127.0.0.1 and localhost" in refusal([host], [])
    same = f"http://{host}"
    assert refusal([host], [same], {same}) is not None


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://app.foxglove.dev.evil.example",
        "null",
        "file://",
        "http://127.0.0.1.evil.example",
        "http://localhost@evil.example",
        "ftp://localhost",
        "",
        "chrome-extension://abc",
        "https://app.foxglove.dev:444",
        "http://app.foxglove.dev",
    ],
)
def test_a_foreign_origin_is_refused(origin):
    assert refusal(["127.0.0.1:1"], [origin], {FOXGLOVE}) is not None


def test_headers_that_are_missing_or_twice_are_refused():
    assert refusal([], []) is not None
    assert refusal(["127.0.0.1", "127.0.0.1"], []) is not None
    assert refusal(["127.0.0.1"], ["http://localhost", "http://localhost"]) == "several origins"


def test_the_refusal_names_the_option_and_no_strange_letters():
    told = refusal(["127.0.0.1"], [FOXGLOVE])
    assert told == f"a web page of {FOXGLOVE!r}; --allow-origin {FOXGLOVE} lets it in"
    assert "\x1b" not in refusal(["127.0.0.1"], ["http://a\x1b[2J"])
    assert len(refusal(["127.0.0.1"], ["http://" + "a" * 10_000])) < 500


@pytest.mark.parametrize("text", ["*", "evil.example", "https://*.dev", "https://a/b", "null", ""])
def test_what_is_no_origin_is_refused_as_an_option(text, tmp_path):
    with pytest.raises(ConfigError, match="expected the scheme and the host of one web page"):
        allowed_origins([text])


def test_origins_are_compared_as_browsers_write_them():
    assert allowed_origins(["HTTPS://App.foxglove.dev/", "file://"]) == {FOXGLOVE, "file://"}


# The Foxglove server


def connected(port):
    """A WebSocket to a server on 127.0.0.1, of a program that is no browser."""
    client = pytest.importorskip("websocket")
    return client.create_connection(
        f"ws://127.0.0.1:{port}",
        subprotocols=["foxglove.sdk.v1"],
        timeout=PATIENCE_S,
        suppress_origin=True,
    )


def status_of(port, *, host=None, origin=None):
    """Status of the handshake of a WebSocket with these headers, as browsers would send them."""
    headers = {
        "Host": host or f"127.0.0.1:{port}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": "foxglove.sdk.v1",
    }
    headers |= {} if origin is None else {"Origin": origin}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as link:
        link.sendall(f"GET / HTTP/1.1\r\n{lines}\r\n".encode())
        return int(link.recv(100).split()[1])


def check_server(port, *, allowed):
    assert status_of(port) == 101
    assert status_of(port, origin=f"http://127.0.0.1:{port}") == 101
    assert status_of(port, host=f"localhost:{port}", origin="http://localhost:8080") == 101
    assert status_of(port, origin="http://evil.example") == 403
    assert status_of(port, origin="null") == 403
    assert status_of(port, origin=FOXGLOVE) == (101 if allowed else 403)
    assert status_of(port, host=f"evil.example:{port}") == 403
    rebound = f"http://evil.example:{port}"
    assert status_of(port, host=f"evil.example:{port}", origin=rebound) == 403


@pytest.mark.parametrize("allowed", [False, True])
def test_the_foxglove_server_asks_for_host_and_origin(allowed):
    refused = []
    server = FoxgloveServer(
        0, option="--port ", allowed={FOXGLOVE} if allowed else (), on_refused=refused.append
    )
    try:
        check_server(server.port, allowed=allowed)
    finally:
        server.stop()
    assert any("http://evil.example" in reason for reason in refused)
    assert len(refused) == len(set(refused))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for command in (
        ["simulate", "circles", "-o", folder / "a.npz", "--scans", 15],
        ["circles", folder / "a.npz", "-o", folder / "run"],
    ):
        assert CliRunner().invoke(app, list(map(str, command))).exit_code == 0
    return folder / "run"


def port_told(process):
    for line in process.stdout:
        if "://127.0.0.1:" in line:
            return int(line.partition("://127.0.0.1:")[2].split()[0].strip(":"))
    raise AssertionError("no address")


@pytest.mark.ci_cases("view-False", "live-True")
@pytest.mark.parametrize("allowed", [False, True])
@pytest.mark.parametrize("command", ["view", "live"])
def test_view_and_live_ask_for_host_and_origin(run, command, allowed):
    """The servers of both commands, as they are started; the option lets one page in."""
    told = {
        "view": ["view", run, "--foxglove", "--port", 0],
        "live": ["live", "--replay", run.parent / "a.npz", "--rate", 0.02, "--out", "foxglove:0"],
    }
    more = ["--allow-origin", FOXGLOVE] if allowed else []
    with running(*told[command], *more, stderr=subprocess.STDOUT) as process:
        check_server(port_told(process), allowed=allowed)
        if not allowed:
            for line in process.stdout:
                if FOXGLOVE in line:
                    break
            assert line == (
                f"refused: a web page of {FOXGLOVE!r}; --allow-origin {FOXGLOVE} lets it in\n"
            )


SERVER = """
import sys
from lidar_core.viz.foxglove_server import serve_foxglove

serve_foxglove(sys.argv[1], port=0, speed=0.5, on_ready=lambda port: print(port, flush=True))
"""
"""Plays a recording again and again, until its process ends."""


@pytest.fixture
def port(run):
    with subprocess.Popen(
        [sys.executable, "-c", SERVER, str(run / "run.mcap")], stdout=subprocess.PIPE
    ) as process:
        yield int(process.stdout.readline())
        process.kill()


def test_a_viewer_gets_every_message_as_it_is_stored(run, port):
    """Over the WebSocket: channels with their schemas, and every message with its time."""
    messages, channels = [], {}
    with (run / "run.mcap").open("rb") as file:
        stored = [
            (schema.name, channel.topic, message.log_time, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
        ]
    link = connected(port)
    until = time.monotonic() + PATIENCE_S
    while set(stored) - set(messages):
        assert time.monotonic() < until
        data = link.recv()
        if isinstance(data, bytes):
            kind, number, log_time = struct.unpack_from("<BIQ", data)
            told = channels[number - 100]
            assert kind == 1
            messages.append((told["schemaName"], told["topic"], log_time, data[13:]))
            continue
        answer = json.loads(data)
        if answer["op"] == "advertise":
            channels.update({told["id"]: told for told in answer["channels"]})
            pairs = [
                {"id": told["id"] + 100, "channelId": told["id"]} for told in answer["channels"]
            ]
            link.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))
    link.close()
    assert set(messages) == set(stored)
    assert {told["encoding"] for told in channels.values()} == {"protobuf"}


def test_a_viewer_that_reads_nothing_is_sent_the_newest():
    """It holds `BACKLOG` messages at most, and does not hold up anybody."""
    server = FoxgloveServer(0, option="--port ")
    try:
        log = ServedLog(server, tracks_frame="world")
        log.write(lc.messages.Pose(0, "world", "a", np.eye(4)))
        link = connected(server.port)
        assert json.loads(link.recv())["op"] == "serverInfo"
        (told,) = json.loads(link.recv())["channels"]
        link.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 99}]}))
        assert json.loads(link.recv())["message"] == "Unknown channel ID: 99"
        link.send(
            json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": told["id"]}]})
        )
        (channel,) = server._channels.values()
        until = time.monotonic() + PATIENCE_S
        while not server._viewers[0].subscriptions_to(channel.id):
            assert time.monotonic() < until
        big = bytes(2**20)
        for number in range(4 * BACKLOG):
            channel.log(big, log_time=number)
        assert len(server._viewers[0]._waiting) == BACKLOG
        times = []
        while not times or times[-1] < 4 * BACKLOG - 1:
            times.append(struct.unpack_from("<BIQ", link.recv())[2])
        assert times == sorted(times)
        assert len(times) < 4 * BACKLOG
        link.close()
    finally:
        server.stop()


@pytest.mark.parametrize("text", ["{", "[]", '{"op": "subscribe"}', '{"op": "other"}', b"\x01\x02"])
def test_a_viewer_that_breaks_the_protocol_harms_itself_alone(text):
    server = FoxgloveServer(0, option="--port ")
    try:
        bad, good = connected(server.port), connected(server.port)
        (bad.send if isinstance(text, str) else bad.send_binary)(text)
        schema = type("Schema", (), {"name": "a", "encoding": "protobuf", "data": b""})
        server.channel("/a", encoding="protobuf", schema=schema, metadata={})
        assert json.loads(good.recv())["op"] == "serverInfo"
        assert json.loads(good.recv())["channels"][0]["topic"] == "/a"
        good.close()
        bad.close()
    finally:
        server.stop()


# Rerun's page


def answer_of(port, path, **headers):
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    with contextlib.closing(link):
        link.request("GET", path, headers=headers)
        answer = link.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


@needs_rerun
def test_reruns_page_asks_for_host_and_origin():
    from lidar_core.viz.rerun_page import RerunPage

    page = RerunPage(lambda: iter([b"the recording"]), port=0)
    try:
        port = int(page.address.rpartition(":")[2])
        assert answer_of(port, "/recording.rrd")[2] == b"the recording"
        for name in ("/", "/page.js", "/re_viewer.js", "/recording.rrd"):
            for headers in (
                {"Host": f"evil.example:{port}"},
                {"Origin": "http://evil.example"},
                {"Origin": "null"},
            ):
                status, _, body = answer_of(port, name, **headers)
                assert (status, body[:7]) == (403, b"refused")
        assert answer_of(port, "/../../etc/passwd")[0] == 404
    finally:
        page.close()
    with pytest.raises(ConnectionRefusedError):
        answer_of(port, "/")
