"""Runs over scans: flying objects, circles; where the scans come from, and their times."""
