"""Commands about finished runs: how good they are, what happened in them, how they look."""
