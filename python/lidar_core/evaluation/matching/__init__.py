"""Which estimate is which target."""
