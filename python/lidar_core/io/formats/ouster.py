"""Ouster captures, OSF files and bags of packets, through ouster-sdk.

ouster-sdk pins versions that other extras cannot live with, so it has an environment of its own.
"""

import heapq
from abc import abstractmethod
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError, MissingExtraError
from lidar_core.extras import install_command, require
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.files.pcap import packet_sizes
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import register_reader
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic, decoded
from lidar_core.messages import Message, Pose, Scan

SENSOR_FRAME, BODY_FRAME, WORLD_FRAME = "os_sensor", "body", "world"
COLUMNS_PER_POSE = 16  # a pose every 1.6 ms at 1024 columns and 10 Hz
COLUMN_IS_VALID = 1  # bit of LidarFrame.status
NO_RETURN = "zero: range 0 in a received column"
POINT_TIME = "of each column, by the sensor's clock"
INSTALL = (
    "reading Ouster recordings needs the package 'ouster-sdk', whose pins clash with other extras:"
    " create a separate environment: python -m venv ouster && ouster/bin/"
)


class _Beams(NamedTuple):
    """Geometry of one sensor."""

    directions: NDArray[np.float64]
    offsets: NDArray[np.float64]
    shifts: NDArray[np.int64]


def holds_ouster_packets(path: Path, options: ReadOptions) -> bool:
    """Whether a capture has its JSON file, or ouster-sdk is installed and knows a bag's sensor."""
    if not path.name.lower().endswith(".bag"):
        packet_sizes(path)  # refuses what is no capture
        return options.metadata is not None or metadata_beside(path) is not None
    if find_spec("ouster") is None:
        return False
    try:
        _require("ouster.sdk.open_source").open_source(str(path), collate=False).close()
    except Exception:
        return False
    return True


def metadata_beside(path: Path) -> Path | None:
    """The JSON file of a capture: the one in its folder whose name begins its own."""
    names = [file for file in path.parent.glob("*.json") if path.stem.startswith(file.stem)]
    return max(names, key=lambda file: len(file.stem), default=None)


class _OusterFrames(Recording):
    """Base of captures and OSF files: converts frames to scans and poses."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._core = _require("ouster.sdk.core")
        self._beams: dict[int, _Beams] = {}
        self._sensors: list[Any] = []
        self._topics: list[Topic] = []

    def topics(self) -> list[Topic]:
        """One stream per sensor."""
        return self._topics

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """One record per frame."""
        if kinds is not None and not kinds & {"scan", "scan+pose"}:
            return
        stored = self._frames()
        number = 0
        while True:
            place = f"{self.path}, frame {number}"
            with reading(place):
                item = next(stored, None)
                if item is None:
                    return
                sensor, frame = item
                messages = self._messages(sensor, frame, place)
            if messages:
                yield Record(self._topics[sensor], messages[-1].stamp_ns, decoded(*messages))
            number += 1

    @abstractmethod
    def _frames(self) -> Iterator[tuple[int, Any]]:
        """Frames with the number of their sensor, in time order."""

    def _set_sensors(self, sensors: list[Any]) -> None:
        self._sensors = sensors
        for number, sensor in enumerate(sensors):
            name = "ouster" if len(sensors) == 1 else f"ouster/{number}"
            size = f"{sensor.prod_line}, {sensor.h} x {sensor.w}"
            self._topics.append(Topic(name, size, "scan+pose"))
            self.findings.no_return[name] = NO_RETURN
            self.findings.point_time[name] = POINT_TIME

    def _frame_id(self, sensor: int) -> str:
        return SENSOR_FRAME if len(self._sensors) == 1 else f"{SENSOR_FRAME}_{sensor}"

    def _messages(self, sensor: int, frame: Any, place: str) -> list[Message]:
        check_size(
            place,
            frame.h * frame.w,
            limit=self.options.max_points,
            key="max_points",
            what="a scan of points",
        )
        received = (frame.status & COLUMN_IS_VALID).astype(bool)
        if not received.any():
            return []
        stamps = np.asarray(frame.timestamp, np.uint64).astype(np.int64)
        stamp_ns = int(stamps[received].min())
        stamps = np.where(received, stamps, stamp_ns)
        poses = self._poses(sensor, frame, stamps, received)
        return [*poses, self._scan(sensor, frame, stamps, received, stamp_ns)]

    def _scan(
        self,
        sensor: int,
        frame: Any,
        stamps: NDArray[np.int64],
        received: NDArray[np.bool_],
        stamp_ns: int,
    ) -> Scan:
        beams = self._beams_of(sensor)
        if "RANGE2" in frame.fields:
            self.findings.note(f"{self._topics[sensor].name}: second returns are not read")
        ranges = np.asarray(frame.field(self._core.ChanField.RANGE), np.float64) * 1e-3
        no_return = (ranges == 0) & received
        points = (ranges[..., None] * beams.directions + beams.offsets).astype(np.float32)
        points[ranges == 0] = np.nan
        columns = {
            "points": points,
            "no_return": no_return,
            "directions": beams.directions.astype(np.float32),
            "times": np.broadcast_to(stamps, ranges.shape),
            "ring": np.broadcast_to(np.arange(frame.h, dtype=np.uint16)[:, None], ranges.shape),
        }
        if "REFLECTIVITY" in frame.fields:
            columns["intensity"] = np.asarray(frame.field("REFLECTIVITY"), np.float32)
        if self.options.destagger:
            columns = {name: _shift_rows(image, beams.shifts) for name, image in columns.items()}
        flat = {name: np.ascontiguousarray(image) for name, image in columns.items()}
        return Scan(
            stamp_ns=stamp_ns,
            points=flat["points"],
            frame_id=self._frame_id(sensor),
            no_return=flat["no_return"].reshape(-1),
            directions=flat["directions"].reshape(-1, 3),
            point_time_ns=flat["times"].reshape(-1),
            intensity=flat["intensity"].reshape(-1) if "intensity" in flat else None,
            ring=flat["ring"].reshape(-1),
            topic=self._topics[sensor].name,
        )

    def _poses(
        self, sensor: int, frame: Any, stamps: NDArray[np.int64], received: NDArray[np.bool_]
    ) -> list[Message]:
        """Mounting of the sensor, and the body's poses where the file holds any."""
        topic = self._topics[sensor].name
        mounting = np.asarray(self._sensors[sensor].sensor_to_body, np.float64)
        frame_id = self._frame_id(sensor)
        result: list[Message] = [
            Pose(
                int(stamps[received][0]),
                BODY_FRAME,
                frame_id,
                mounting,
                is_static=True,
                topic=topic,
            )
        ]
        matrices = np.asarray(frame.body_to_world, np.float64)
        if np.array_equal(matrices, np.broadcast_to(np.eye(4), matrices.shape)):
            return result
        valid = np.flatnonzero(received)
        chosen = np.unique(np.append(valid[::COLUMNS_PER_POSE], valid[-1]))
        result += [
            Pose(int(stamps[column]), WORLD_FRAME, BODY_FRAME, matrices[column].copy(), topic=topic)
            for column in chosen
        ]
        return result

    def _beams_of(self, sensor: int) -> _Beams:
        """Directions and origins of all pixels: a point is range * direction + offset."""
        if sensor not in self._beams:
            info = self._sensors[sensor]
            lut = self._core.XYZLut(info, use_extrinsics=False)
            near, far = (
                np.asarray(lut(np.full((info.h, info.w), millimetres, np.uint32)), np.float64)
                for millimetres in (1_000, 101_000)
            )
            directions = (far - near) / 100
            self._beams[sensor] = _Beams(
                directions,
                near - directions,
                np.asarray(info.format.pixel_shift_by_row, np.int64),
            )
        return self._beams[sensor]


@register_reader(
    "Ouster packets",
    [".pcap", ".pcapng", ".bag"],
    sniff=holds_ouster_packets,
    extra="ouster",
    note="captures with their .json; needs its own environment",
)
class OusterRecording(_OusterFrames):
    """A packet capture with its JSON file, or a bag of packets."""

    format = "Ouster packets"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        if path.name.lower().endswith(".pcapng"):
            raise FormatError(f"{path}: ouster-sdk reads pcap; convert it: editcap -F pcap IN OUT")
        super().__init__(path, options)
        library = _require("ouster.sdk.open_source")
        beside = Path(options.metadata) if options.metadata is not None else metadata_beside(path)
        meta = {} if beside is None or path.suffix == ".bag" else {"meta": [str(beside)]}
        with reading(str(path)):
            self._source = library.open_source(str(path), collate=False, **meta)
            self._set_sensors(list(self._source.sensor_info))

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def _frames(self) -> Iterator[tuple[int, Any]]:
        for group in self._source:
            for sensor in group.valid_indices():
                yield sensor, group[sensor]


@register_reader("Ouster OSF", [".osf"], extra="ouster")
class OsfRecording(_OusterFrames):
    """An OSF file; problems that ouster-sdk only logs raise an error here."""

    format = "Ouster OSF"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._osf = _require("ouster.sdk.osf")
        _require("ouster.sdk.core").init_logger("off")
        self._reports: list[str] = []
        with reading(str(path)):
            self._reader = self._osf.Reader(str(path), lambda _, text: self._reports.append(text))
            self._check_reports()
            found = self._reader.meta_store.find(self._osf.LidarSensor)
            streams = self._reader.meta_store.find(self._osf.LidarFrameStream)
            self._set_sensors([entry.info for entry in found.values()])
        order = {meta_id: number for number, meta_id in enumerate(found)}
        self._sensor_of = {stream: order[meta.sensor_meta_id] for stream, meta in streams.items()}

    def _frames(self) -> Iterator[tuple[int, Any]]:
        count = 0
        streams = [self._reader.messages([stream]) for stream in self._sensor_of]
        for message in heapq.merge(*streams, key=lambda item: item.ts):
            frame = message.decode()
            self._check_reports()
            if frame is None:
                raise FormatError(f"{self.path}: a frame cannot be decoded; record it again")
            yield self._sensor_of[message.id], frame
            count += 1
        self._check_reports()
        if count == 0:
            raise FormatError(f"{self.path}: no frame can be read; the file is damaged")

    def _check_reports(self) -> None:
        if self._reports:
            text = "; ".join(dict.fromkeys(self._reports))
            raise FormatError(
                f"{self.path}: {text.rstrip('.')}. The file is damaged or of another version:"
                " take it from the source again, or convert it with the ouster-sdk that wrote it"
            )


def _require(module: str) -> Any:
    try:
        return require(module, extra="ouster", purpose="reading Ouster recordings")
    except MissingExtraError as error:
        raise MissingExtraError(INSTALL + install_command("ouster")) from error


def _shift_rows(image: NDArray[Any], shifts: NDArray[np.int64]) -> NDArray[Any]:
    """`image` with every row rolled by its shift, so that columns share an azimuth."""
    width = image.shape[1]
    columns = (np.arange(width)[None, :] - shifts[:, None]) % width
    shifted: NDArray[Any] = image[np.arange(image.shape[0])[:, None], columns]
    return shifted
