"""What ouster-sdk makes of recordings and of made packets; runs where it is installed, alone.

Usage: python ouster_probe.py DATA_FOLDER SCRATCH_FOLDER
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from ouster.sdk import core, osf
from ouster.sdk.open_source import open_source

ROWS, COLUMNS, IN_PACKET = 32, 512, 16
NO_PROFILES = ("OFF", "UNKNOWN")


def stored(path: Path) -> Iterator[tuple[int, Any, Any]]:
    """Sensor, its description and frame, for all frames of a recording."""
    if path.suffix == ".osf":
        reader = osf.Reader(str(path))
        sensors = list(reader.meta_store.find(osf.LidarSensor).items())
        streams = reader.meta_store.find(osf.LidarFrameStream)
        order = {number: index for index, (number, _) in enumerate(sensors)}
        for message in reader.messages(list(streams)):
            index = order[streams[message.id].sensor_meta_id]
            yield index, sensors[index][1].info, message.decode()
        return
    source = open_source(str(path), collate=False)
    for group in source:
        for index in group.valid_indices():
            yield index, source.sensor_info[index], group[index]
    source.close()


def recorded(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Frames of one recording: ranges, points, reflectivity and times as the library has them."""
    seen: Counter[int] = Counter()
    for sensor, info, frame in stored(path):
        lut = core.XYZLut(info, use_extrinsics=False)
        name = f"{path.name}|{sensor}|{seen[sensor]}|"
        seen[sensor] += 1
        ranges = np.asarray(frame.field("RANGE"))
        arrays[name + "ranges"] = ranges
        arrays[name + "points"] = np.asarray(lut(frame))
        arrays[name + "reflectivity"] = np.asarray(frame.field("REFLECTIVITY"))
        if frame.has_field("RANGE2"):
            arrays[name + "ranges2"] = np.asarray(frame.field("RANGE2"))
            arrays[name + "reflectivity2"] = np.asarray(frame.field("REFLECTIVITY2"))
        arrays[name + "stamps"] = np.asarray(frame.timestamp)
        arrays[name + "received"] = (np.asarray(frame.status) & 1).astype(bool)
        arrays[name + "destaggered"] = np.asarray(core.destagger(info, ranges))
        arrays[name + "mounting"] = np.asarray(info.sensor_to_body)


def made(metadata: dict, profile: str, arrays: dict[str, np.ndarray]) -> None:
    """One frame of random packets of a profile, and what the library reads in it."""
    rng = np.random.default_rng(len(profile))
    metadata["data_format"]["udp_profile_lidar"] = profile
    text = json.dumps(metadata)
    info = core.SensorInfo(text)
    layout = core.PacketFormat(info)
    packets, ranges, reflectivity = [], [], []
    second: dict[str, list[np.ndarray]] = {}
    is_dual = "DUAL" in profile or profile == "FIVE_WORD_PIXEL"
    received = rng.random(COLUMNS) < 0.9
    stamps = rng.integers(0, 2**62, COLUMNS)
    for first in range(0, COLUMNS, IN_PACKET):
        packet = core.LidarPacket(layout)
        packet.buf[:] = rng.integers(0, 256, layout.lidar_packet_size, np.uint8)
        if layout.packet_header_size:
            is_fusa = profile.startswith("FUSA")
            packet.buf[: 1 if is_fusa else 2] = [1] if is_fusa else [1, 0]
        layout.set_frame_id(packet, 7)
        for column in range(IN_PACKET):
            layout.set_col_measurement_id(packet, column, first + column)
            layout.set_col_status(packet, column, int(received[first + column]))
            layout.set_col_timestamp(packet, column, int(stamps[first + column]))
        packets.append(np.array(packet.buf))
        ranges.append(np.array(layout.packet_field("RANGE", packet.buf)))
        reflectivity.append(np.array(layout.packet_field("REFLECTIVITY", packet.buf)))
        for key, field in (("ranges2", "RANGE2"), ("reflectivity2", "REFLECTIVITY2")):
            if is_dual:
                second.setdefault(key, []).append(np.array(layout.packet_field(field, packet.buf)))
    name = f"{profile}|"
    arrays[name + "metadata"] = np.array(text)
    arrays[name + "packets"] = np.array(packets)
    arrays[name + "ranges"] = np.concatenate(ranges, axis=1) * received
    arrays[name + "reflectivity"] = np.concatenate(reflectivity, axis=1) * received
    for key, parts in second.items():
        arrays[name + key] = np.concatenate(parts, axis=1) * received
    arrays[name + "stamps"] = stamps
    arrays[name + "received"] = received


def moving_osf(source: Path, path: Path) -> None:
    """Copy of `source` whose body moves at 1 m/s along x and turns."""
    frames = [f for group in open_source(str(source), collate=False) for f in group.valid_frames()]
    with osf.Writer(str(path), frames[0].sensor_info) as writer:
        start = int(frames[0].timestamp[frames[0].timestamp > 0].min())
        for frame in frames:
            poses = np.tile(np.eye(4), (frame.w, 1, 1))
            poses[:, 0, 3] = (frame.timestamp.astype(np.int64) - start) * 1e-9
            poses[:, :2, :2] = [[0, -1], [1, 0]]
            frame.body_to_world[:] = poses
            writer.save(0, frame)


def main(data: Path, scratch: Path) -> None:
    """Write every array to one file, and one OSF file with poses."""
    arrays: dict[str, np.ndarray] = {}
    for file in sorted((data / "3d/ouster").iterdir()):
        if file.suffix in {".bag", ".osf", ".pcap"}:
            recorded(file, arrays)
    metadata = json.loads((data / "3d/ouster/OS-0-32-U1_v2.2.0_1024x10.json").read_text())
    metadata["data_format"] |= {"columns_per_frame": COLUMNS, "column_window": [0, COLUMNS - 1]}
    metadata["lidar_mode"] = "512x10"
    profiles = [name for name in dir(core.UDPProfileLidar) if name.isupper()]
    for profile in profiles:
        if profile not in NO_PROFILES:
            made(metadata, profile, arrays)
    np.savez(scratch / "library.npz", **arrays)
    moving_osf(data / "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.osf", scratch / "moving.osf")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
