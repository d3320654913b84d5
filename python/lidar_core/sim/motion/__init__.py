"""Ways of sensors and targets."""
