"""Where live results go."""
