"""Items (tables and figures) of the paper on flying objects in 3D LiDAR, and our own items."""
