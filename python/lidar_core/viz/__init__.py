"""Pictures of runs; plotting packages are imported when one is drawn."""

from lidar_core.viz.flying_picture import draw_flying
from lidar_core.viz.views import FlyingView

__all__ = ["FlyingView", "draw_flying"]
