"""Where live messages come from."""
