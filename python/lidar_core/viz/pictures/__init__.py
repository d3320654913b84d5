"""Pictures of whole runs: from above, and values over time."""
