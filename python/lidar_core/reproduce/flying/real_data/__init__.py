"""Recorded sequences, targets inserted into them, and what a detector reports."""
