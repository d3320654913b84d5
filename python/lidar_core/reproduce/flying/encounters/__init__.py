"""Short scripted encounters before a hovering sensor: drones that cross or hide."""
