"""Outputs of live results."""
