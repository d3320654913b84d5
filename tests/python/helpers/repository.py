"""Where tests find what is not theirs: the checkout and the folder of real recordings."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[3]
"""The checkout."""
RECORDINGS = Path(os.environ.get("LIDAR_CORE_DATA", ROOT.parent / "shared" / "data"))
"""Real recordings; the folder need not exist."""
