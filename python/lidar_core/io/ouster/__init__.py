"""Readers of Ouster's data without Ouster's library: sensor files, packets, OSF files."""
