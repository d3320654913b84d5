"""Tables of `benches/figures.py`, a file per subject."""
