"""Jobs of a batch: which commands they may hold, and how one is run."""
