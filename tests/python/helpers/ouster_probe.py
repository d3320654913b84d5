"""Facts about Ouster recordings, printed as JSON; runs where ouster-sdk is installed.

Usage: python ouster_probe.py DATA_FOLDER SCRATCH_FOLDER
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from ouster.sdk import core, osf
from ouster.sdk.open_source import open_source

import lidar_core
import lidar_core.io as lc_io
from lidar_core.messages import Pose, Scan


def scan_facts(scan: Scan) -> dict[str, Any]:
    """Sizes, times and consistency of one scan."""
    rows = scan.points.reshape(-1, 3)
    finite = np.isfinite(rows).all(axis=1)
    directions = scan.directions[finite]
    along = np.sum(rows[finite] * directions, axis=1) / np.linalg.norm(rows[finite], axis=1)
    return {
        "shape": list(scan.points.shape),
        "points": int(finite.sum()),
        "no_return": int(scan.no_return.sum()),
        "both": int((finite & scan.no_return).sum()),
        "unit_error": float(np.abs(np.linalg.norm(scan.directions, axis=1) - 1).max()),
        "worst_cosine": float(along.min()),
        "first_ns": int(scan.point_time_ns.min() - scan.stamp_ns),
        "span_ns": int(np.ptp(scan.point_time_ns)),
        "topic": scan.topic,
        "rings": int(scan.ring.max()) + 1,
    }


def recording_facts(path: Path) -> dict[str, Any]:
    """Scans and summary of one recording, or the error."""
    try:
        with lc_io.open_recording(path) as recording:
            scans = [scan_facts(message) for message in recording if isinstance(message, Scan)]
            info = recording.info().to_dict()
    except lidar_core.LidarCoreError as error:
        return {"error": type(error).__name__, "text": str(error)}
    return {"scans": scans, "info": info}


def geometry_facts(path: Path) -> dict[str, float]:
    """Largest difference from the library's own look-up table [m], and after destaggering."""
    with lc_io.open_recording(path) as recording:
        ours = [message for message in recording if isinstance(message, Scan)]
    with lc_io.open_recording(path, destagger=True) as recording:
        shifted = [message for message in recording if isinstance(message, Scan)]
    source = open_source(str(path), collate=False)
    frames = [frame for group in source for frame in group.valid_frames()]
    info = source.sensor_info[0]
    lut = core.XYZLut(info, use_extrinsics=False)
    worst = worst_shifted = 0.0
    for frame, scan, moved in zip(frames, ours, shifted, strict=True):
        expected = np.asarray(lut(frame))
        hit = np.asarray(frame.field("RANGE")) > 0
        worst = max(worst, float(np.abs(scan.points - expected)[hit].max()))
        ranges = core.destagger(info, frame.field("RANGE"))
        image = core.destagger(info, expected)
        worst_shifted = max(worst_shifted, float(np.abs(moved.points - image)[ranges > 0].max()))
    return {"staggered": worst, "destaggered": worst_shifted}


def moving_osf(source: Path, path: Path) -> None:
    """Copy of `source` whose body moves at 1 m/s along x."""
    frames = [f for group in open_source(str(source), collate=False) for f in group.valid_frames()]
    with osf.Writer(str(path), frames[0].sensor_info) as writer:
        start = int(frames[0].timestamp[frames[0].timestamp > 0].min())
        for frame in frames:
            poses = np.tile(np.eye(4), (frame.w, 1, 1))
            poses[:, 0, 3] = (frame.timestamp.astype(np.int64) - start) * 1e-9
            frame.body_to_world[:] = poses
            writer.save(0, frame)


def pose_facts(data: Path, scratch: Path) -> dict[str, Any]:
    """Poses from an OSF file, from a KITTI file, and the error without any."""
    still = data / "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.osf"
    moving = scratch / "moving.osf"
    moving_osf(still, moving)
    with lc_io.open_recording(moving) as recording:
        posed = list(lc_io.posed_scans(recording))
        kinds = sorted({(m.frame_id, m.child_frame_id) for m in recording if isinstance(m, Pose)})
    worst = 0.0
    start = posed[0].pose_stamps_ns[0]
    for item in posed:
        expected = (item.pose_stamps_ns - start) * 1e-9
        worst = max(worst, float(np.abs(item.world_from_lidar[:, 0, 3] - expected).max()))
    capture = data / "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap"
    poses = data / "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt"
    with lc_io.open_recording(capture) as recording:
        kitti = [
            item.world_from_lidar[0, 3]
            for item in lc_io.posed_scans(recording, pose=poses.as_posix())
        ]
        try:
            list(lc_io.posed_scans(recording))
            text = ""
        except lidar_core.FormatError as error:
            text = str(error)
    return {
        "edges": kinds,
        "scans": len(posed),
        "poses_per_scan": len(posed[1].pose_stamps_ns),
        "worst": worst,
        "kitti_x": kitti,
        "without": text,
    }


def damage_facts(data: Path, scratch: Path) -> dict[str, dict[str, int]]:
    """What becomes of files cut at many places: refused, or read up to the cut."""
    result = {}
    for name in ("osf_fw_3.2_10scans.osf", "OS-1-32-G_v2.1.1_1024x10.pcap"):
        original = data / "3d/ouster" / name
        content = original.read_bytes()
        copy = scratch / f"cut{original.suffix}"
        if original.suffix == ".pcap":
            copy.with_suffix(".json").write_bytes(original.with_suffix(".json").read_bytes())
        outcomes: dict[str, int] = {}
        for length in range(1, len(content), len(content) // 40):
            copy.write_bytes(content[:length])
            facts = recording_facts(copy)
            key = facts.get("error", "read")
            if key != "read" and str(copy) not in facts["text"]:
                key = f"unnamed: {facts['text']}"
            outcomes[key] = outcomes.get(key, 0) + 1
        result[original.suffix] = outcomes
    return result


def main(data: Path, scratch: Path) -> None:
    """Print every fact."""
    suffixes = {".bag", ".osf", ".pcap"}
    files = [f for f in sorted((data / "3d/ouster").iterdir()) if f.suffix in suffixes]
    files += sorted((data / "formats/ouster_broken").iterdir())
    facts = {
        "version": lidar_core.__version__,
        "recordings": {file.name: recording_facts(file) for file in files},
        "geometry": {
            name: geometry_facts(data / "3d/ouster" / name)
            for name in ("OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "osf_fw_3.2_10scans.osf")
        },
        "poses": pose_facts(data, scratch),
        "damage": damage_facts(data, scratch),
    }
    sys.stdout.write(json.dumps(facts))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
