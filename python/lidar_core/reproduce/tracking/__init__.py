"""Items about mechanisms that all trackers share: noise of sensors, dropouts."""
