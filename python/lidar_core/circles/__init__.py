"""Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities."""

from lidar_core.circles.scanner import Scanner

__all__ = ["Scanner"]
