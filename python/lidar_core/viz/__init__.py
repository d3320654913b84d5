"""Pictures of runs; plotting packages are imported when one is drawn."""

from lidar_core.objects import Objects
from lidar_core.viz.pictures.circles_picture import animate_circles, draw_circles
from lidar_core.viz.pictures.flying_picture import draw_flying
from lidar_core.viz.pictures.fusion_picture import draw_fusion
from lidar_core.viz.playback import Moment, Outline, Playback
from lidar_core.viz.playback_picture import draw_film, draw_moment
from lidar_core.viz.report import write_report
from lidar_core.viz.views import CirclesView, FlyingView, FusionView, PlanarLine

__all__ = [
    "CirclesView",
    "FlyingView",
    "FusionView",
    "Moment",
    "Objects",
    "Outline",
    "PlanarLine",
    "Playback",
    "animate_circles",
    "draw_circles",
    "draw_film",
    "draw_flying",
    "draw_fusion",
    "draw_moment",
    "write_report",
]


def __dir__() -> list[str]:
    return __all__
