"""Recordings of 2D scanners in rooms and halls: content, static objects, scores."""
