"""Hostile files: every format, broken in every way we can think of, read in a limited child.

`python -m hostile --help` (with `tests` in PYTHONPATH), or `make hostile`.
"""
