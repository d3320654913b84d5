"""Source of the packets of a sensor, directly from the network."""

import socket
import time
from collections.abc import Callable
from threading import Event, Thread
from typing import Protocol

from lidar_core.errors import FormatError, LinkError
from lidar_core.io.ouster.stream import RepeatedFrameError
from lidar_core.io.records import Findings, Record, Topic, decoded
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.sensor_clock import SensorClock
from lidar_core.live.sources.source import Source
from lidar_core.messages import Scan

ANY_ADDRESS = "0.0.0.0"  # sensors send to the address that they are set to, often a broadcast
LARGEST = 65_536
BUFFER_BYTES = 4 * 2**20
PATIENCE_S = 0.2  # how soon `close` is noticed
SILENCE_S = 2.0  # without packets, after which something must be wrong


class PacketStream(Protocol):
    """Interface of decoders of the packets of one sensor.

    Attributes
    ----------
    topic : Topic
        Topic of its scans.
    """

    topic: Topic

    def scan(self, stamp_ns: int, packet: bytes, *, place: str) -> Scan | None:
        """Return the scan that a packet completes.

        Raises
        ------
        RepeatedFrameError
            With this packet it is clear that a scan came again, or too late.
        FormatError
            The packet is of another kind.
        """


class UdpSource(Source):
    """Source that listens for the packets of a sensor on all addresses of this machine.

    Parameters
    ----------
    port : int
        UDP port; 0 takes a free one.
    stream : callable
        Called with the findings to which it adds; makes the decoder of the packets.
    kind : str
        Kind of the source, as a user names it.
    own_clock : bool
        True if stamps come from the sensor's clock.
    """

    def __init__(
        self,
        port: int,
        stream: Callable[[Findings], PacketStream],
        *,
        kind: str = "udp",
        own_clock: bool = False,
    ) -> None:
        super().__init__(kind)
        self._stream = stream(self.findings)
        self._clock = SensorClock(self.findings) if own_clock else None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.bind((ANY_ADDRESS, port))
        except OSError as error:
            self._socket.close()
            raise LinkError(
                f"{kind}: port {port} cannot be opened ({error.strerror}); stop the program that"
                " uses it, or let the sensor send to another port and give it here:"
                f" {kind}:{'HOST@' if kind == 'ouster' else ''}PORT"
            ) from error
        self.port = int(self._socket.getsockname()[1])
        self.name = f"{kind}, port {self.port}"
        self._heard = time.monotonic()
        self._n_packets = 0
        self._ended = Event()
        self._thread: Thread | None = None

    def start(self, inbox: Inbox) -> None:
        """Begin to listen."""
        self._socket.settimeout(PATIENCE_S)
        self._thread = Thread(target=self._listen, args=(inbox,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        self._socket.close()

    def trouble(self) -> str:
        """Problem of the source, if no packets arrive."""
        is_silent = time.monotonic() - self._heard > SILENCE_S
        return f"no packets on port {self.port}" if is_silent else ""

    def silence(self) -> str:
        """Reason why no scan arrived: packets without a scan, or no packets at this address."""
        if self._n_packets:
            return f"packets come to port {self.port}, but no scan is complete"
        return (
            f"no packet came to port {self.port}; check the destination address and port that are"
            " set in the sensor, and the firewall of this machine"
        )

    def _listen(self, inbox: Inbox) -> None:
        try:
            while not self._ended.is_set():
                try:
                    packet, _ = self._socket.recvfrom(LARGEST)
                except TimeoutError:
                    continue
                self._heard = time.monotonic()
                self._n_packets += 1
                self._take(packet, inbox)
        except Exception as error:  # whatever it is, the loop raises it where the user is
            inbox.fail(error)

    def _take(self, packet: bytes, inbox: Inbox) -> None:
        """Process one packet; count it if it is invalid."""
        arrival_ns = time.time_ns()
        try:
            scan = self._stream.scan(arrival_ns, packet, place=self.name)
        except RepeatedFrameError as error:
            inbox.refuse(self._stream.topic.name, str(error))
            return
        except FormatError as error:
            inbox.reject(self.name)
            self.findings.note(str(error))
            return
        if scan is None:
            return
        if self._clock is not None:
            scan = self._clock.to_local_clock(scan, arrival_ns)
        inbox.put(Record(self._stream.topic, arrival_ns, decoded(scan)))
