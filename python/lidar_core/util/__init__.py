"""What capabilities, runs and commands share and users do not call."""
