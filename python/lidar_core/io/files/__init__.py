"""Files: what is inside them, read with limits and written whole."""
