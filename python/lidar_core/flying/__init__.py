"""Detection and tracking of flying objects in 3D LiDAR."""
