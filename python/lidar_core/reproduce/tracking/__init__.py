"""Items about what all trackers share: noise of sensors, dropouts."""
