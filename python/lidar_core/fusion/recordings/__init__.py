"""Readers and writers of recorded measurements."""
