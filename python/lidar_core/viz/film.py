"""Films from a figure that is drawn frame by frame."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lidar_core.errors import ConfigError, MissingExtraError
from lidar_core.extras import require
from lidar_core.io.files.atomic import written_whole
from lidar_core.viz.figure import PURPOSE, figure_with_style


def write_film(
    path: str | Path,
    paint: Callable[[Any], Iterator[None]],
    *,
    size: tuple[float, float],
    dpi: int,
    rate: float,
) -> Path:
    """Let `paint` draw frame after frame into a matplotlib Figure, and write them as a film.

    Parameters
    ----------
    path : str or Path
        .gif, or .mp4 where ffmpeg is installed; written atomically.
    paint : callable
        Called with the Figure; yields whenever a frame is drawn.
    size : (float, float)
        Width and height [inch].
    dpi : int
        Pixels per inch.
    rate : float
        Frames per second [Hz].

    Raises
    ------
    ConfigError
        Another ending.
    MissingExtraError
        matplotlib or, for .mp4, ffmpeg is not installed.
    """
    place = Path(path)
    writer = _writer(place, rate)
    with figure_with_style(size=size, dpi=dpi) as figure, written_whole(place) as file:
        named = file.with_suffix(place.suffix)
        try:
            writer.setup(figure, str(named), dpi=dpi)
            for _ in paint(figure):
                writer.grab_frame()
            writer.finish()
            named.replace(file)
        finally:
            named.unlink(missing_ok=True)
    return place


def film_ending() -> str:
    """Return `.mp4` if matplotlib finds ffmpeg, else `.gif`."""
    try:
        return ".mp4" if _animation().FFMpegWriter.isAvailable() else ".gif"
    except MissingExtraError:
        return ".gif"


def _writer(path: Path, rate: float) -> Any:
    if path.suffix.lower() == ".gif":
        return _gif_writer(rate)
    if path.suffix.lower() != ".mp4":
        raise ConfigError(f"{path}: expected a film that ends in .gif or .mp4")
    if not _animation().FFMpegWriter.isAvailable():
        raise MissingExtraError(f"{path}: .mp4 needs the program ffmpeg; .gif does not")
    return _animation().FFMpegWriter(fps=rate)


def _gif_writer(rate: float) -> Any:
    """Return a writer of GIF files whose 256 colours cover all colours that occur.

    With matplotlib's writer, Pillow takes the most frequent colours. Small things, such as a trail
    or a mark in the legend, then get the colour of something else.
    """
    image = require("PIL.Image", extra="plot", purpose=PURPOSE)

    class Writer(_animation().PillowWriter):  # type: ignore[misc]
        def grab_frame(self, **options: Any) -> None:
            super().grab_frame(**options)
            self._frames[-1] = (
                self._frames[-1]
                .convert("RGB")
                .quantize(256, method=image.Quantize.MAXCOVERAGE, dither=image.Dither.NONE)
            )

    return Writer(fps=rate)


def _animation() -> Any:
    return require("matplotlib.animation", extra="plot", purpose=PURPOSE)
