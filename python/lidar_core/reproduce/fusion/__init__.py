"""Items of the paper on LiDAR and radar fusion."""
