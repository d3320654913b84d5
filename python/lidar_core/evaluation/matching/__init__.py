"""Assignment of estimates to targets."""
