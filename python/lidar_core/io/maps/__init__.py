"""Clouds and maps in files."""
