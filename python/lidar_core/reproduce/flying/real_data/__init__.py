"""Recorded sequences, inserted targets, and the reports of a detector."""
