"""Simulated flights, detectors that run on them, and their stored results."""
