"""Readers of third-party formats in a child process; a crash of it becomes an error here."""
