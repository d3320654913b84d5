"""Shapes of targets and bodies, and shapes with moving parts."""
