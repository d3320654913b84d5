"""Items of the paper on flying objects in 3D LiDAR, and what lies beyond it."""
