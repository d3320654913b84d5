"""Recordings of LiDAR and radar, and how well their targets are followed."""
