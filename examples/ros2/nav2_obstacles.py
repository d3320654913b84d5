"""Tracks as points for the obstacle layer of Nav2, where they are and where they will be soon.

Nav2's own ObstacleLayer reads a PointCloud2, so no plugin has to be compiled. In its parameters:

    local_costmap:
      local_costmap:
        ros__parameters:
          plugins: ["obstacle_layer", "inflation_layer"]
          obstacle_layer:
            plugin: "nav2_costmap_2d::ObstacleLayer"
            observation_sources: lidar_core
            lidar_core:
              topic: /lidar_core/obstacles
              data_type: "PointCloud2"
              marking: true
              clearing: false
              observation_persistence: 0.0
              expected_update_rate: 1.0
              min_obstacle_height: -10.0
              max_obstacle_height: 10.0
"""

import numpy as np

from lidar_core.io.write.ros import RosMessages
from lidar_core.live import Output
from lidar_core.messages import Scan

TOPIC, CLOUD = "lidar_core/obstacles", "sensor_msgs/msg/PointCloud2"
HORIZON_S, STEP_S = 1.0, 0.2  # how far ahead, and how often, positions are predicted
SPACING = 0.05  # of points, at most a cell of the costmap [m]
LEAST_RADIUS = 0.1  # of a track, whose size may be that of a single return [m]
MOST_POINTS = 100_000


def disc(radius):
    """Points of a disc around the origin, shape (N, 2), no two neighbours far apart."""
    steps = np.arange(-radius, radius + SPACING, SPACING)
    x, y = np.meshgrid(steps, steps)
    is_inside = np.hypot(x, y) <= radius
    return np.stack([x[is_inside], y[is_inside]], axis=1)


def obstacle_points(objects):
    """Points (N, 3) that the objects cover now and within the horizon, by constant velocity."""
    parts = [np.zeros((0, 3))]
    for position, velocity, size in zip(
        objects.position, objects.velocity, objects.size, strict=True
    ):
        area = disc(max(LEAST_RADIUS, float(np.hypot(*size[:2])) / 2))
        for ahead in np.arange(0.0, HORIZON_S + STEP_S / 2, STEP_S):
            center = position + ahead * velocity
            parts.append(np.column_stack([area + center[:2], np.full(len(area), center[2])]))
    return np.concatenate(parts)[:MOST_POINTS].astype(np.float32)


class ObstacleOutput(Output):
    """Publisher of a node: a cloud per scan, empty if nothing is there, which clears the last."""

    def __init__(self, node, message_of):
        super().__init__(f"node: {TOPIC}")
        self.context, self.messages = node.context, RosMessages(2)
        self.publisher = node.create_publisher(message_of(CLOUD), TOPIC, 10)

    def publish(self, update):
        """Publish the points of all objects, until ROS is shut down."""
        if not self.context.ok():
            return
        points = obstacle_points(update.objects)
        _, message = self.messages.of(Scan(update.stamp_ns, points, update.frame_id))
        self.publisher.publish(self.messages.packed(message))

    def close(self):
        """Publishers end with their node."""
