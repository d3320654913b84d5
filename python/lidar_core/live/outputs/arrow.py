"""Tracks, or elements of a map, as a stream of Arrow that grows with every scan."""

from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.extras import require
from lidar_core.io.files.atomic import check_place
from lidar_core.live.outputs.output import Output
from lidar_core.live.outputs.update import Update


class ArrowOutput(Output):
    """Output to a file of Arrow's streaming format: one batch per scan, readable while it grows.

    Columns are `stamp_ns` and those of the objects' `to_columns`; the frame is in the metadata of
    the schema.

    Parameters
    ----------
    path : Path
        File to write.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    MissingExtraError
        pyarrow is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._arrow = require("pyarrow", extra="tables", purpose="the output arrow")
        check_place(path)
        super().__init__(f"arrow, {path}")
        self._path = path
        self._file: Any = None
        self._writer: Any = None

    def publish(self, update: Update) -> None:
        """Append the objects of a scan; without objects, an empty batch."""
        columns = update.states.to_columns()
        stamps = np.full(len(update.states), update.stamp_ns, np.int64)
        batch = self._arrow.record_batch({**columns, "stamp_ns": stamps})
        if self._writer is None:
            told = {"frame_id": update.frame_id, "capability": update.capability}
            schema = batch.schema.with_metadata(told)
            self._file = self._path.open("wb")
            self._writer = self._arrow.ipc.new_stream(self._file, schema)
        self._writer.write_batch(batch)
        self._file.flush()

    def close(self) -> None:
        """Complete the file; without scans none is written."""
        if self._writer is not None:
            self._writer.close()
            self._file.close()
