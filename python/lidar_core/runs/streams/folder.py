"""The folder of a live run: like those of `detect` and `circles`, for the processed scans."""

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
from lidar_core.run_folder import RunFolder, fingerprint, remove_checkpoint
from lidar_core.runs.checkpoints import Checkpoints
from lidar_core.runs.result import MCAP, count_unposed, draw, wants_mcap
from lidar_core.runs.scans.circles_output import CirclesRun
from lidar_core.runs.scans.flying_output import FlyingRun


class LiveFolder(Output):
    """Keeps the data of the tables, some kilobytes per scan; `write` makes complete files of it.

    Parameters
    ----------
    folder : RunFolder
        Begun with the first scan.
    pipeline : callable
        Called with a kind of scans; makes its pipeline, as in `LiveLoop`.
    checkpoint : float, optional
        Time between two checkpoints [s].
    resume : bool
        Continue from the last checkpoint in the folder.
    threads : int
        Number of threads of a detector that continues.

    Attributes
    ----------
    failed : OSError or None
        Why run.mcap could not be completed; the other files are there.
    """

    def __init__(
        self,
        folder: RunFolder,
        pipeline: Callable[[type], LivePipeline[Any] | None],
        *,
        checkpoint: float | None = None,
        resume: bool = False,
        threads: int = 1,
    ) -> None:
        super().__init__(str(folder.path))
        self._threads = threads
        self._every, self._resumes, self._n_published = checkpoint, resume, 0
        self._checkpoints: Checkpoints | None = None
        self._folder, self._make = folder, pipeline
        self._pipeline: LivePipeline[Any] | None = None
        self._run: FlyingRun | CirclesRun | None = None
        self._is_begun = False
        self._stack = ExitStack()
        self.failed: OSError | None = None

    def pipeline(self, sort: type) -> LivePipeline[Any] | None:
        """Return the pipeline for scans of a kind, which is remembered.

        Raises
        ------
        InputError, FormatError
            The checkpoint in the folder is damaged, or belongs to another configuration or build.
        """
        self._pipeline = made = self._make(sort)
        if self._every is None and not self._resumes:
            return made
        if isinstance(made, FlyingLive):
            config: Config = made.detector.config
        elif isinstance(made, CirclesLive):
            config = made.config
        else:
            return made
        decides = {"command": "live", made.capability: config.model_dump(mode="json")}
        self._checkpoints = Checkpoints(self._folder.path, self._every, decides)
        if not self._resumes:
            return made
        if isinstance(made, FlyingLive):
            flying = FlyingRun(made.detector, threads=self._threads)
            self._n_published = self._checkpoints.resume(flying)
            made.detector, self._run = flying.detector, flying
        else:
            circles = CirclesRun(CirclePipeline(made.config, allow_untrusted=made.allow_untrusted))
            self._n_published = self._checkpoints.resume(circles)
            if self._n_published:
                made.pipeline, self._run = circles.pipeline, circles
        return made

    def publish(self, update: Update) -> None:
        """Keep the results of a scan."""
        if self._run is None or not self._is_begun:
            self._begin(update.frame_id)
        run = self._run
        if isinstance(update, FlyingUpdate):
            if isinstance(run, FlyingRun):
                run.keep(update.item, update.frame, _computed_ms(update))
        elif isinstance(update, CirclesUpdate) and isinstance(run, CirclesRun):
            run.keep(update.item, update.frame, _computed_ms(update))
        self._n_published += 1
        if self._checkpoints is not None and run is not None:
            self._checkpoints.take(run, self._n_published)

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
            Names of the files; notes on files that could not be written because an extra is
            missing.
        """
        self.close()
        run, folder = self._run, self._folder
        if run is None or not self._is_begun:
            return summary, [], []
        drawn, notes = draw(run.pictures(folder, summary["source"]))
        files = [*run.write(folder), *drawn]
        files += [name for name in (MCAP,) if (folder.path / name).exists()]
        told = {**summary, **run.summary()}
        count_unposed(told)
        folder.write_summary(told)
        made_of = {name: fingerprint(path) for name, path in inputs.items() if path is not None}
        folder.write_note({"stream": summary["source"], **made_of}, {**self._config(), **config})
        remove_checkpoint(folder.path)
        return told, sorted([*files, "run.toml", "summary.json"]), notes

    def _begin(self, frame_id: str) -> None:
        """Begin the folder and the run of the pipeline, at its first scan."""
        used, run = self._used(), self._run
        if run is None:
            run = FlyingRun(used) if isinstance(used, FlyingObjectDetector) else CirclesRun(used)
        run.frame_id = frame_id
        self._folder.begin()
        # Nobody can go on with a run.mcap that was cut.
        if self._checkpoints is None and wants_mcap(None):
            self._stack.enter_context(run.open_mcap(self._folder))
        self._run, self._is_begun = run, True

    def _used(self) -> FlyingObjectDetector | CirclePipeline:
        """Detector or pipeline that processed the scans."""
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
