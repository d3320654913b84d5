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
from pathlib import Path
from threading import Event

import zenoh

import lidar_core as lc
from lidar_core.io.write.ros import RosMessages
from lidar_core.live.sources.replay import ReplaySource
from lidar_core.live.sources.source import StreamTopics
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


class Publisher(lc.live.Inbox):
    """Takes what a replay gives, and publishes it."""

    def __init__(self, replay, put):
        super().__init__(max_poses=1)
        self.replay, self.send = replay, put
        self.messages = RosMessages(2)
        self.ended = Event()
        self.error = None

    def put(self, record):
        """Publish the scans and poses of one record."""
        for item in record.decode():
            lead_ns = self.replay.lead_ns(item.stamp_ns)
            topic, message = self.messages.of(sent_at(item, item.stamp_ns + lead_ns))
            type_hash = self.messages.store.hash_rihs01(message.__msgtype__)
            key = key_of(topic, message.__msgtype__, type_hash, domain=0)
            self.send(key, self.messages.packed(message))

    def finish(self):
        """Note that the recording ended."""
        self.ended.set()

    def fail(self, error):
        """Note that the recording could not be read to its end."""
        self.error = error
        self.ended.set()


def main(path, rate="1", address=ADDRESS):
    """Wait for somebody to listen, then play."""
    session = session_at(address)
    print(f"{address}: waiting for lidar-core live", flush=True)
    anything = session.declare_publisher("**")
    while not anything.matching_status.matching:  # a link alone does not listen
        time.sleep(0.1)
    time.sleep(1.0)  # until everything is subscribed to
    replay = ReplaySource(Path(path), lc.io.ReadOptions(), rate=float(rate), topics=StreamTopics())
    publisher = Publisher(replay, session.put)
    replay.start(publisher)
    publisher.ended.wait()
    replay.close()
    session.close()
    if publisher.error is not None:
        raise publisher.error
    print("played to the end")


if __name__ == "__main__":
    if {"-h", "--help"} & set(sys.argv):
        print(__doc__)
    elif not 1 <= len(sys.argv[1:]) <= 3:
        sys.exit(__doc__)
    else:
        main(*sys.argv[1:])
