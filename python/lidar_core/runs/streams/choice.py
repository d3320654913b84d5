"""Sources, outputs and pipelines of a live run, by their names."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lidar_core.circles import CirclesConfig
from lidar_core.errors import ConfigError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import ReadOptions
from lidar_core.io.poses.posed import KISS
from lidar_core.io.write.mcap import partial_path
from lidar_core.live import LiveConfig, Output, Source
from lidar_core.live.metrics import MetricsServer
from lidar_core.live.pipelines import CirclesLive, FlyingLive, LivePipeline
from lidar_core.live.sources.source import StreamTopics
from lidar_core.messages import LaserScan, Scan
from lidar_core.runs.flying import load_known_map
from lidar_core.runs.result import MCAP
from lidar_core.runs.settings import ConfigChoice, config_of_run
from lidar_core.viz.origin_check import LOCAL

SOURCES = (
    "zenoh[:tcp/HOST:PORT], foxglove[:ws://HOST:PORT], velodyne[:PORT],"
    " ouster:HOST|FILE.json[@PORT], livox[:PORT]"
)
OUTPUTS = (
    "foxglove[:PORT], zenoh[:tcp/HOST:PORT], rerun[:web[:PORT]|:FILE.rrd], mcap:FILE, arrow:FILE"
)
OTHER_SENSORS = ("hesai", "robosense")
"""Whose packets are not read from the network."""
FOXGLOVE_PORT, PAGE_PORT = 8765, 9090
VELODYNE_PORT, LIVOX_PORT = 2368, 56_301


@dataclass(frozen=True, slots=True)
class PipelineChoice:
    """Pipeline for scans of a stream; it is made when the first scan shows its kind."""

    capability: Literal["auto", "flying", "circles"]
    clouds: tuple[str, ...]
    scans: tuple[str, ...]
    config: FlyingConfig | CirclesConfig | ConfigChoice | None
    known_map: Path | None
    threads: int
    allow_untrusted: bool = False

    def __post_init__(self) -> None:
        """Refuse options that contradict each other."""
        if self.clouds and self.scans:
            raise ConfigError("cloud, scan: expected topics of one kind, got both")
        for wanted, named in (("flying", self.scans), ("circles", self.clouds)):
            if named and self.capability == wanted:
                raise ConfigError(f"capability: {wanted} does not read {', '.join(named)}")
        if self.known_map is not None and not self.wants_clouds:
            raise ConfigError("map: applies only to flying objects in clouds, got 2D scans")

    @property
    def wants_clouds(self) -> bool:
        """Return whether the pipeline takes clouds."""
        return self.capability != "circles" and not self.scans

    @property
    def wants_scans(self) -> bool:
        """Return whether the pipeline takes 2D scans."""
        return self.capability != "flying" and not self.clouds and self.known_map is None

    def topics(self, odometry: str | None) -> StreamTopics:
        """Return the topics to request from a stream."""
        return StreamTopics(self.clouds, self.scans, self.wants_clouds, self.wants_scans, odometry)

    def silence(self, source: Source, advertised: Sequence[str]) -> str:
        """Return a message that the source brings no wanted scan, with the reason or its topics."""
        if reason := source.silence():
            return f"no scan yet: {reason}"
        sorts = " or ".join(
            what
            for what, wanted in (("clouds", self.wants_clouds), ("2D scans", self.wants_scans))
            if wanted
        )
        named = ", ".join((*self.clouds, *self.scans)) or f"any topic with {sorts}"
        return f"no scan yet of {named}; {source.name} has: {'; '.join(advertised) or 'nothing'}"

    def pipeline(self, sort: type) -> LivePipeline[Any] | None:
        """Return the pipeline for scans of a kind; None if it is not wanted."""
        if sort is Scan and self.wants_clouds:
            return self._flying()
        return self._circles() if sort is LaserScan and self.wants_scans else None

    def _flying(self) -> FlyingLive:
        config: Any = self.config
        detector = FlyingObjectDetector(
            config_of_run(config, FlyingConfig, "flying"), threads=self.threads
        )
        if self.known_map is not None:
            load_known_map(detector, self.known_map)
        return FlyingLive(detector)

    def _circles(self) -> CirclesLive:
        config: Any = self.config
        return CirclesLive(
            config_of_run(config, CirclesConfig, "circles"),
            n_scanners=max(1, len(self.scans)),
            allow_untrusted=self.allow_untrusted,
        )


def open_source(
    text: str | None,
    replay: Path | None,
    *,
    rate: float | None,
    read: ReadOptions,
    live: LiveConfig,
    topics: StreamTopics,
    pose: str,
) -> Source:
    """Open the source of a live run: a stream, or a recording to `replay`.

    Raises
    ------
    ConfigError
        None or both are given, the source is unknown, or it has no poses and `pose` needs some.
    """
    if (text is None) == (replay is None):
        raise ConfigError(f"source, replay: expected one of them; a source is {SOURCES}")
    if replay is not None:
        from lidar_core.live.sources.replay import ReplaySource

        return ReplaySource(replay, read, rate=rate or 1.0, topics=topics)
    if rate is not None:
        raise ConfigError("rate: does not apply to a stream, only to replay=FILE")
    kind, _, place = str(text).partition(":")
    if kind == "zenoh":
        from lidar_core.live.sources.zenoh import ZenohSource
        from lidar_core.live.zenoh_link import DEFAULT_ENDPOINT

        return ZenohSource(place or DEFAULT_ENDPOINT, topics, read, live)
    if kind == "foxglove":
        from lidar_core.live.sources.foxglove import DEFAULT_ADDRESS, FoxgloveSource

        return FoxgloveSource(place or DEFAULT_ADDRESS, topics, read, live)
    if kind in ("velodyne", "ouster", "livox"):
        if pose == "auto":
            raise ConfigError(
                f'source: {text}: packets of a sensor carry no poses; add pose="static" for a'
                f' sensor that does not move, or pose="{KISS}" for poses from the scans'
            )
        return _open_packets(kind, place, read)
    drivers = (
        '; of this sensor run the driver, and listen to its topic: source="zenoh" clouds=TOPIC'
    )
    raise ConfigError(
        f"source: {text}: expected one of {SOURCES}{drivers if kind in OTHER_SENSORS else ''}"
    )


def _open_packets(kind: str, place: str, read: ReadOptions) -> Source:
    """Open a source of the packets of a sensor."""
    from lidar_core.live.sources.udp import UdpSource

    what = f"source: {kind}"
    if kind == "ouster":
        from lidar_core.io.ouster.stream import DEFAULT_PORT, OusterStream, sensor_at

        where, _, given = place.rpartition("@") if "@" in place else (place, "", "")
        if not where:
            raise ConfigError(f"{what}: expected ouster:HOST or ouster:FILE.json")
        sensor = sensor_at(where, read)
        port = _port(given, what) if given else sensor.port or DEFAULT_PORT
        return UdpSource(
            port, lambda found: OusterStream(sensor, read, found), kind=kind, own_clock=True
        )
    if kind == "livox":
        from lidar_core.io.messages.livox_packets import LivoxStream

        port = _port(place or str(LIVOX_PORT), what)
        return UdpSource(port, lambda found: LivoxStream(read, found), kind=kind, own_clock=True)
    from lidar_core.io.messages.velodyne import VelodyneStream

    port = _port(place or str(VELODYNE_PORT), what)
    return UdpSource(port, lambda found: VelodyneStream(read, found), kind=kind)


def open_metrics(text: str) -> MetricsServer:
    """Start a server of metrics at PORT of this machine, or at HOST:PORT.

    Raises
    ------
    ConfigError
        The text names no such address.
    LinkError
        The port cannot be opened.
    """
    host, _, port = text.rpartition(":")
    return MetricsServer(host or LOCAL, _port(port, "metrics"))


def check_files(
    outputs: Iterable[str],
    replayed: Path | None,
    folder: Path | None,
    tape: Path | None = None,
    *,
    overwrite: bool,
) -> None:
    """Refuse output files that already have content, also in `folder`, before anything is opened.

    Raises
    ------
    ConfigError
        A file is there that must not be replaced, belongs to the recording that is played, or is
        named twice.
    """
    places = [path for text in outputs if (path := _file(text)) is not None]
    places += [] if tape is None else [tape]
    counts = Counter(path.resolve() for path in places)
    of_run = [] if folder is None else [folder / MCAP]
    partial = [partial_path(path) for path in places if path.suffix.lower() == ".mcap"]
    for path in (*places, *of_run, *partial):
        if path in of_run and counts[path.resolve()]:
            raise ConfigError(
                f"outputs: mcap:{path}: the run writes this file into {folder}"
                " anyway; leave this output out"
            )
        if counts[path.resolve()] > 1:
            raise ConfigError(
                f"outputs: {path}: expected once, it is given {counts[path.resolve()]} times"
            )
        if not path.exists():
            continue
        if replayed is not None and path.resolve().is_relative_to(replayed.resolve()):
            raise ConfigError(f"{path}: is also the input; choose another file to write")
        if not overwrite:
            left = (
                f", left by a run that was killed, if none is at it: lidar-core convert {path}"
                " saved.mcap --recover saves it"
                if path in partial
                else ""
            )
            raise ConfigError(f"{path}: exists{left}; overwrite=True replaces it")


def _file(text: str) -> Path | None:
    """File that an output names; None if the output is not a file."""
    kind, _, place = text.partition(":")
    is_file = (kind in ("mcap", "arrow") and place) or (kind == "rerun" and place.endswith(".rrd"))
    return Path(place) if is_file else None


def open_output(
    text: str,
    live: LiveConfig,
    *,
    allowed: Collection[str] = (),
    on_refused: Callable[[str], None] = lambda reason: None,
) -> Output:
    """Output of a live run by its name.

    Parameters
    ----------
    text : str
        Text of the option.
    live : LiveConfig
        Names of the Zenoh keys of the outputs.
    allowed : collection of str
        Web pages that may connect to a server, from `allowed_origins`.
    on_refused : callable
        Called with the reason when a client is refused.

    Raises
    ------
    ConfigError
        The output is unknown.
    """
    from lidar_core.live.outputs import output as outputs

    kind, _, place = text.partition(":")
    file = _file(text)
    if file is not None and kind == "arrow":
        from lidar_core.live.outputs.arrow import ArrowOutput

        return ArrowOutput(file)
    if file is not None:
        return outputs.McapOutput(file) if kind == "mcap" else outputs.RerunOutput(file)
    if kind == "foxglove":
        port = _port(place or str(FOXGLOVE_PORT), "outputs: foxglove")
        return outputs.FoxgloveOutput(port, allowed=allowed, on_refused=on_refused)
    if kind == "rerun" and place in ("", "window"):
        return outputs.RerunWindowOutput()
    if kind == "rerun" and place.partition(":")[0] == "web":
        port = _port(place.partition(":")[2] or str(PAGE_PORT), "outputs: rerun:web")
        return outputs.RerunPageOutput(port)
    if kind == "zenoh":
        from lidar_core.live.outputs.zenoh import ZenohOutput
        from lidar_core.live.zenoh_link import DEFAULT_ENDPOINT

        return ZenohOutput(place or DEFAULT_ENDPOINT, live)
    raise ConfigError(f"outputs: {text}: expected one of {OUTPUTS}")


def _port(text: str, what: str) -> int:
    if not text.isdigit() or int(text) > 65535:
        raise ConfigError(f"{what}: expected a port from 0 to 65535, got {text!r}")
    return int(text)
