"""Items of the paper on flying objects in 3D LiDAR, and our own items."""
