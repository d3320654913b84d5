"""Containers and compressed files, read with limits; atomic writing of files."""
