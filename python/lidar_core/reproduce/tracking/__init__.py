"""Items about mechanisms that all trackers share, such as sensor noise and dropouts."""
