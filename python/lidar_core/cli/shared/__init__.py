"""Parts that commands share: options, consoles, tables of results."""
