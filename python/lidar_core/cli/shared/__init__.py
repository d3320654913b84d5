"""What the commands share: options, consoles, tables of results."""
