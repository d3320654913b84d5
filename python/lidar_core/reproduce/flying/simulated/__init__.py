"""Simulated flights through detectors, and what is kept of them."""
