"""Poses of the sensor for each scan."""
