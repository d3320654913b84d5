"""Targets put into recorded scans."""
