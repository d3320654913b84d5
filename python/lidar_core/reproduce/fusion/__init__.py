"""Items (tables and figures) of the paper on LiDAR and radar fusion."""
