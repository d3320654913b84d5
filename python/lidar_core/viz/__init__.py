"""Pictures of runs; plotting packages are imported when one is drawn."""

from typing import TYPE_CHECKING

# Its modules import each other: two threads that begin with two of them wait for each other.
import lidar_core.io  # noqa: F401
from lidar_core.util.lazy import first_use

if TYPE_CHECKING:
    from lidar_core.objects import Objects as Objects
    from lidar_core.viz.pictures.circles_picture import animate_circles as animate_circles
    from lidar_core.viz.pictures.circles_picture import draw_circles as draw_circles
    from lidar_core.viz.pictures.flying_picture import draw_flying as draw_flying
    from lidar_core.viz.pictures.fusion_picture import draw_fusion as draw_fusion
    from lidar_core.viz.playback import Moment as Moment
    from lidar_core.viz.playback import Outline as Outline
    from lidar_core.viz.playback import Playback as Playback
    from lidar_core.viz.playback_picture import draw_film as draw_film
    from lidar_core.viz.playback_picture import draw_moment as draw_moment
    from lidar_core.viz.report import write_report as write_report
    from lidar_core.viz.views import CirclesView as CirclesView
    from lidar_core.viz.views import FlyingView as FlyingView
    from lidar_core.viz.views import FusionView as FusionView
    from lidar_core.viz.views import PlanarLine as PlanarLine

_HOMES = {
    "CirclesView": "lidar_core.viz.views",
    "FlyingView": "lidar_core.viz.views",
    "FusionView": "lidar_core.viz.views",
    "Moment": "lidar_core.viz.playback",
    "Objects": "lidar_core.objects",
    "Outline": "lidar_core.viz.playback",
    "PlanarLine": "lidar_core.viz.views",
    "Playback": "lidar_core.viz.playback",
    "animate_circles": "lidar_core.viz.pictures.circles_picture",
    "draw_circles": "lidar_core.viz.pictures.circles_picture",
    "draw_film": "lidar_core.viz.playback_picture",
    "draw_flying": "lidar_core.viz.pictures.flying_picture",
    "draw_fusion": "lidar_core.viz.pictures.fusion_picture",
    "draw_moment": "lidar_core.viz.playback_picture",
    "write_report": "lidar_core.viz.report",
}
"""What is imported when it is first used: a picture of one capability does not need the others."""

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

if not TYPE_CHECKING:  # so that type checkers find misspelt names
    __getattr__ = first_use(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
