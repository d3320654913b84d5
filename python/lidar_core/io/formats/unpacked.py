"""ROS 2 recordings whose files were compressed: unpacked for as long as they are open."""

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from lidar_core.io.files.compressed import unpack_zstd
from lidar_core.io.formats.chain import ChainedRecording, Opener
from lidar_core.io.options import ReadOptions

PACKED = (".db3.zstd", ".mcap.zstd")
"""How the names of such files end."""


class UnpackedRecording(ChainedRecording):
    """Files that `ros2 bag record --compression-mode file` left, in a temporary folder."""

    def __init__(self, path: Path, options: ReadOptions, files: list[Path], opened: Opener) -> None:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="lidar_core-")))
            left, unpacked = options.max_unpacked_bytes, []
            for file in files:
                unpacked.append(folder / file.stem)
                left -= unpack_zstd(file, unpacked[-1], left)
            super().__init__(path, options, unpacked, opened)
            self.format = f"{self._parts[0].format}, unpacked"
            self._folder = stack.pop_all()

    def close(self) -> None:
        """Close every file, and remove them."""
        super().close()
        self._folder.close()
