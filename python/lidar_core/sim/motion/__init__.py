"""Motions of sensors and targets."""
