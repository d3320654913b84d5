"""Where the sensor was at each scan."""
