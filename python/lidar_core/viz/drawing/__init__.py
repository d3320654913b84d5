"""Shared parts of pictures: the visible part of the world, IDs of tracks, scale bars."""
