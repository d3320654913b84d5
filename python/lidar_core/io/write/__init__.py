"""Recordings, tables and messages out."""
