"""A robot to try `lidar-core live` with: plays a recording over Zenoh, with rmw_zenoh's keys.

    python examples/robot_on_zenoh.py RECORDING [RATE] [ADDRESS]
    lidar-core live --in zenoh --out foxglove --out zenoh

Others link to ADDRESS, by default tcp/127.0.0.1:7447, where the router of a real robot would be.
Times of messages are those at which they are sent.
"""

import json
import sys
import time
from dataclasses import replace

import zenoh

import lidar_core as lc
from lidar_core.io.write_ros import RosMessages
from lidar_core.live.zenoh_link import key_of

ADDRESS = "tcp/127.0.0.1:7447"


def session_at(address):
    """Session that others link to."""
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([address]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def sent_at(item, stamp_ns):
    """A scan or a pose with another time; times of points move with it."""
    moved = {"stamp_ns": stamp_ns}
    if getattr(item, "point_time_ns", None) is not None:
        moved["point_time_ns"] = item.point_time_ns + (stamp_ns - item.stamp_ns)
    return replace(item, **moved)


def play(path, put, *, rate=1.0):
    """Call `put(key, bytes)` for every message of a recording, in time."""
    messages = RosMessages(2)
    with lc.io.open_recording(path) as recording:
        first_ns = min(record.time_ns for record in recording.records() if record.time_ns)
        begin_ns = time.time_ns()
        for item in recording:
            due_ns = begin_ns + round((item.stamp_ns - first_ns) / rate)
            topic, message = messages.of(sent_at(item, due_ns))
            type_hash = messages.store.hash_rihs01(message.__msgtype__)
            raw = messages.packed(message)
            time.sleep(max(due_ns - time.time_ns(), 0) * 1e-9)
            put(key_of(topic, message.__msgtype__, type_hash, domain=0), raw)


def main(path, rate="1", address=ADDRESS):
    """Wait for somebody to listen, then play."""
    session = session_at(address)
    print(f"{address}: waiting for lidar-core live", flush=True)
    while not list(session.info.peers_zid()):
        time.sleep(0.1)
    time.sleep(1.0)  # until it has subscribed
    play(path, session.put, rate=float(rate))
    print("played to the end")
    session.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
