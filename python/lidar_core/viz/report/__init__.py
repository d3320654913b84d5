"""One HTML file about a run: works without a network and sends nothing."""

from lidar_core.viz.report.document import write_report

__all__ = ["write_report"]
