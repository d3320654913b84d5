"""Training of the neural networks that lidar_core runs; a distribution of its own."""

__all__ = ["__version__"]

__version__ = "0.1.0"
