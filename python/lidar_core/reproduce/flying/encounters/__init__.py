"""Short scripted encounters in front of a hovering sensor: drones that cross or hide."""
