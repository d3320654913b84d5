"""Long runs as of a robot: hours of one loop, a flight of 50 km, scans at a steady rate."""
