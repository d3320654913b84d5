"""Recordings: one file per format."""
