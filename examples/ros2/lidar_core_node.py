"""A ROS 2 node: clouds or 2D scans in, Detection3DArray and Odometry out.

    source /opt/ros/jazzy/setup.bash
    python3 -m venv --system-site-packages venv && venv/bin/pip install 'lidar-core[io]'
    venv/bin/python lidar_core_node.py --ros-args -p scan:=/scan -p fixed_frame:=odom

Parameters: cloud or scan (topic), odom (topic of an Odometry), fixed_frame, pose (auto or static).
Messages stay bytes on their way through rclpy; lidar_core reads and writes them.
"""

import time
from functools import partial
from threading import Thread

from lidar_core.circles import CirclesConfig
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import PoseOptions, ReadOptions, Topic
from lidar_core.io.messages.ros import RosDecoder, kind_of
from lidar_core.io.records import Record
from lidar_core.io.write.ros import RosMessages
from lidar_core.live import LiveConfig, LiveLoop, Output, Source
from lidar_core.live.outputs.ros import TYPES, ros_messages
from lidar_core.live.pipelines import CirclesLive, FlyingLive
from lidar_core.live.poses import LivePoses
from lidar_core.messages import LaserScan

NAME = "lidar_core"
CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
TRANSFORMS, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"


def wanted_topics(parameters):
    """Types of the topics to subscribe to, by their names."""
    sorts = {"cloud": CLOUD, "scan": SCAN, "odom": ODOMETRY}
    named = {parameters[key]: sort for key, sort in sorts.items() if parameters.get(key)}
    return {"/tf": TRANSFORMS, "/tf_static": TRANSFORMS, **named}


def pipeline_for(sort):
    """Pipeline for scans of a sort, made when the first one arrives."""
    if sort is LaserScan:
        return CirclesLive(CirclesConfig(on_bad_scan="count"), n_scanners=1)
    return FlyingLive(FlyingObjectDetector(FlyingConfig(on_bad_scan="count"), threads=2))


class NodeSource(Source):
    """Subscriptions of a node.

    `message_of` gives the class of a type, `quality_of` the quality of service of a topic.
    """

    def __init__(self, node, topics, message_of, quality_of):
        super().__init__(f"node {NAME}: {', '.join(topics)}")
        self.node, self.topics = node, topics
        self.message_of, self.quality_of = message_of, quality_of
        self.decoder = RosDecoder(2, ReadOptions(), self.findings)
        self.subscriptions = []

    def start(self, inbox):
        """Subscribe."""
        for name, sort in self.topics.items():
            topic = Topic(name, sort, kind_of(sort))
            take = partial(self.take, inbox, topic)
            quality = self.quality_of(name)
            subscription = self.node.create_subscription(
                self.message_of(sort), name, take, quality, raw=True
            )
            self.subscriptions.append(subscription)

    def take(self, inbox, topic, raw):
        """One message, from the thread that spins."""
        decode = partial(self.decoder.decode, topic.name, topic.type, bytes(raw), topic.name)
        inbox.put(Record(topic, time.time_ns(), decode))

    def close(self):
        """End the subscriptions."""
        while self.subscriptions:
            self.node.destroy_subscription(self.subscriptions.pop())


class NodeOutput(Output):
    """Publishers of a node: lidar_core/tracks and lidar_core/odometry."""

    def __init__(self, node, message_of):
        super().__init__(f"node {NAME}: {', '.join(TYPES)}")
        self.context = node.context
        self.messages = RosMessages(2)
        self.publishers = {
            name: node.create_publisher(message_of(sort), f"{NAME}/{name}", 10)
            for name, sort in TYPES.items()
        }

    def publish(self, update):
        """Publish tracks and the odometry of each, until ROS is shut down."""
        for name, message in ros_messages(update, self.messages):
            if not self.context.ok():
                return
            self.publishers[name].publish(self.messages.packed(message))

    def close(self):
        """Publishers end with their node."""


def loop_of(node, parameters, message_of, quality_of, more=()):
    """Loop that does the work of the node; `more` are classes of further outputs."""
    topics = wanted_topics(parameters)
    options = {key: parameters[key] for key in ("pose", "fixed_frame") if parameters.get(key)}
    source = NodeSource(node, topics, message_of, quality_of)
    outputs = [make(node, message_of) for make in (NodeOutput, *more)]
    poses = LivePoses(PoseOptions(**options), LiveConfig())
    return LiveLoop(source, pipeline_for, poses, outputs, LiveConfig())


def qualities():
    """Quality of service of a topic, by its name."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

    def quality_of(name):
        if name.endswith("tf_static"):
            return QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        return QoSProfile(depth=100) if name == "/tf" else qos_profile_sensor_data

    return quality_of


def main():
    """Spin in one thread, work in another; the end of either ends both."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rosidl_runtime_py.utilities import get_message

    rclpy.init()
    node = rclpy.create_node(NAME)
    names = ("cloud", "scan", "odom", "fixed_frame", "pose")
    parameters = {name: node.declare_parameter(name, "").value for name in names}
    loop = loop_of(node, parameters, get_message, qualities())

    def spin():
        try:
            rclpy.spin(node)
        except ExternalShutdownException:  # Ctrl-C, SIGTERM, `ros2 launch` that ends
            pass
        finally:
            loop.inbox.finish()

    Thread(target=spin, daemon=True).start()
    try:
        loop.run()
    except KeyboardInterrupt:
        pass
    finally:
        print(loop.summary())
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
