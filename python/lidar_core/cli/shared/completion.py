"""Completion of topics in the shell, from the recording on the command line."""

from collections.abc import Callable

import typer

Complete = Callable[[typer.Context, str], list[str]]


def topics_of(*kinds: str) -> Complete:
    """Return a completion of topics with these kinds (`lidar_core.io.Topic`); none given: all."""

    def complete(context: typer.Context, incomplete: str) -> list[str]:
        from lidar_core.errors import LidarCoreError
        from lidar_core.io import open_recording

        # The line ends with an option that has no value yet: what stands before it is not parsed.
        recording = context.params.get("recording") or next(iter(context.args), None)
        if recording is None:
            return []
        try:
            with open_recording(recording) as opened:
                topics = opened.topics()
        except (LidarCoreError, OSError):
            return []  # a shell that completes a line shows no errors
        names = [topic.name for topic in topics if not kinds or topic.kind in kinds]
        return [name for name in names if name.startswith(incomplete)]

    return complete


CLOUDS = topics_of("scan", "scan+pose", "packets")
SCANS = topics_of("planar", "planar+pose")
POSES = topics_of("pose", "scan+pose", "planar+pose")
ALL = topics_of()
