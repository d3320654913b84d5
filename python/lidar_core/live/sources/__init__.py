"""Sources of live messages."""
