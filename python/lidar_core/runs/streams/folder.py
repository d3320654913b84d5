"""The folder that a live run leaves: as `detect` and `circles` write it, of what was processed."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from lidar_core.circles import CirclePipeline
from lidar_core.config import Config
from lidar_core.flying import FlyingObjectDetector
from lidar_core.live import Output, Update
from lidar_core.live.outputs.update import CirclesUpdate, FlyingUpdate
from lidar_core.live.pipelines import CirclesLive, FlyingLive, LivePipeline
from lidar_core.run_folder import RunFolder, fingerprint
from lidar_core.runs.circle_map import CirclesRun
from lidar_core.runs.flying import FlyingRun
from lidar_core.runs.result import MCAP, draw, wants_mcap


class LiveFolder(Output):
    """Keeps what tables need, some kilobytes a scan; `write` makes whole files of it.

    Parameters
    ----------
    folder : RunFolder
        Begun with the first scan.
    pipeline : callable
        Makes the pipeline for scans of a sort, as `LiveLoop` has it.

    Attributes
    ----------
    failed : OSError or None
        Why run.mcap could not be completed; the other files are there.
    """

    def __init__(
        self, folder: RunFolder, pipeline: Callable[[type], LivePipeline[Any] | None]
    ) -> None:
        super().__init__(str(folder.path))
        self._folder, self._make = folder, pipeline
        self._pipeline: LivePipeline[Any] | None = None
        self._run: FlyingRun | CirclesRun | None = None
        self._stack = ExitStack()
        self.failed: OSError | None = None

    def pipeline(self, sort: type) -> LivePipeline[Any] | None:
        """The pipeline for scans of a sort, which is remembered."""
        self._pipeline = self._make(sort)
        return self._pipeline

    def publish(self, update: Update) -> None:
        """Keep what a scan gave."""
        run = self._run or self._begun(update.frame_id)
        if isinstance(update, FlyingUpdate):
            if isinstance(run, FlyingRun):
                run.keep(update.item, update.frame, _computed_ms(update))
        elif isinstance(update, CirclesUpdate) and isinstance(run, CirclesRun):
            run.keep(update.item, update.frame, _computed_ms(update))

    def close(self) -> None:
        """Complete run.mcap."""
        try:
            self._stack.close()
        except OSError as error:
            self.failed = error

    def write(
        self,
        summary: dict[str, Any],
        config: Mapping[str, Config],
        inputs: Mapping[str, Path | None],
    ) -> tuple[dict[str, Any], list[str], list[str]]:
        """Write tables, picture, run.toml and summary.json.

        Without a scan nothing is written.

        Returns
        -------
        summary : dict
            `summary` with the results of the pipeline.
        files, notes : list of str
            Names of the files; what could not be written because an extra is missing.
        """
        self.close()
        run, folder = self._run, self._folder
        if run is None:
            return summary, [], []
        drawn, notes = draw(run.pictures(folder, summary["source"]))
        files = [*run.write(folder), *drawn]
        files += [name for name in (MCAP,) if (folder.path / name).exists()]
        told = {**summary, **run.summary()}
        folder.write_summary(told)
        made_of = {name: fingerprint(path) for name, path in inputs.items() if path is not None}
        folder.write_note({"stream": summary["source"], **made_of}, {**self._config(), **config})
        return told, sorted([*files, "run.toml", "summary.json"]), notes

    def _begun(self, frame_id: str) -> FlyingRun | CirclesRun:
        """The run of the pipeline, at its first scan."""
        used = self._used()
        run = FlyingRun(used) if isinstance(used, FlyingObjectDetector) else CirclesRun(used)
        run.frame_id = frame_id
        self._folder.begin()
        if wants_mcap(None):
            self._stack.enter_context(run.open_mcap(self._folder))
        self._run = run
        return run

    def _used(self) -> FlyingObjectDetector | CirclePipeline:
        """What took the scans."""
        made = self._pipeline
        if isinstance(made, FlyingLive):
            return made.detector
        if isinstance(made, CirclesLive) and made.pipeline is not None:
            return made.pipeline
        raise TypeError(f"no pipeline that leaves a folder: {made}")

    def _config(self) -> dict[str, Config]:
        used = self._used()
        name = "flying" if isinstance(used, FlyingObjectDetector) else "circles"
        return {name: used.config}


def _computed_ms(update: FlyingUpdate | CirclesUpdate) -> float:
    """Time that the stages of a scan took together [ms]."""
    return sum(update.frame.timing_ms.values())
