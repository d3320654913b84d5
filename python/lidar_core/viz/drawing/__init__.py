"""Shared parts of pictures: the visible part of the world, numbers of tracks, scale bars."""
