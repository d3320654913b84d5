"""Recordings of 2D scanners in rooms and halls: what they hold, what stands in them, scores."""
