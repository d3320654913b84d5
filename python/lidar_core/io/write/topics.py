"""Default topics for messages without a topic."""

SCAN_TOPIC, LASER_TOPIC = "/lidar/points", "/laser/scan"
POSE_TOPIC, STATIC_TOPIC, ODOMETRY_TOPIC = "/tf", "/tf_static", "/odom"
