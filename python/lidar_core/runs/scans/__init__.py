"""Runs over scans: flying objects, circles; the source of the scans, and their times."""
