"""Fits and networks that estimate circles from groups of rays."""
