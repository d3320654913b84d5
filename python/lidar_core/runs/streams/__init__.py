"""Live runs: their sources and outputs by name, and the folder that they leave."""
