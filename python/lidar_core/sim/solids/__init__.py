"""Shapes of targets and bodies, and those that move by themselves."""
