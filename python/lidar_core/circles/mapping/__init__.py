"""The semantic map of circles and other shapes."""
