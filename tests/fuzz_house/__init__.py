"""Fuzzing guided by coverage: Rust targets, Python readers, every callable of `_core`."""
