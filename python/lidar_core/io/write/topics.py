"""Topics that writers use for what has none of its own."""

SCAN_TOPIC, LASER_TOPIC = "/lidar/points", "/laser/scan"
POSE_TOPIC, STATIC_TOPIC, ODOMETRY_TOPIC = "/tf", "/tf_static", "/odom"
