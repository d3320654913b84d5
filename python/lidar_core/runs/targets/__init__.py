"""Runs of `fuse`: one target or many, their tables and pictures."""
