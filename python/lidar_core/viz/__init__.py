"""Pictures of runs; plotting packages are imported when one is drawn."""

from lidar_core.viz.circles_picture import animate_circles, draw_circles
from lidar_core.viz.flying_picture import draw_flying
from lidar_core.viz.views import CirclesView, FlyingView

__all__ = ["CirclesView", "FlyingView", "animate_circles", "draw_circles", "draw_flying"]
