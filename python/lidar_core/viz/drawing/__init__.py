"""Shared parts of pictures: visible part of the world, drawn points, IDs of tracks, scale bars."""
