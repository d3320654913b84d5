"""ROS 2 recordings with compressed files, unpacked while they are open."""

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from lidar_core.errors import FormatError
from lidar_core.io.chain import ChainedRecording
from lidar_core.io.files.compressed import unpack_zstd
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import reader_of, register_reader
from lidar_core.io.recording import Recording


@register_reader(
    "ROS 2 compressed by file",
    [".db3.zstd", ".mcap.zstd"],
    extra="io",
    folder="together",
    marker="metadata.yaml",
)
class UnpackedRecording(ChainedRecording):
    """Files of `ros2 bag record --compression-mode file`, unpacked in a temporary folder."""

    def __init__(self, path: Path, options: ReadOptions, files: list[Path]) -> None:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="lidar_core-")))
            left, unpacked = options.max_unpacked_bytes, []
            for file in files:
                unpacked.append(folder / file.stem)
                left -= unpack_zstd(file, unpacked[-1], left)
            super().__init__(path, options, unpacked, _open_unpacked)
            self.format = f"{self._parts[0].format}, unpacked"
            self._folder = stack.pop_all()

    def close(self) -> None:
        """Close every file, and remove them."""
        super().close()
        self._folder.close()


def _open_unpacked(file: Path, options: ReadOptions) -> Recording:
    reader = reader_of(file, options)
    if reader is None:  # the compressed name ends as one that is known
        raise FormatError(f"{file}: unknown format")
    return reader.opened(file, options, [file])
