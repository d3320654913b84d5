"""Internal helpers of capabilities, runs and commands."""
