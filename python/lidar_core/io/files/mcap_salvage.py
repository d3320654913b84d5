"""Complete messages of an MCAP file that was not closed, was truncated, or has broken chunks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lidar_core.errors import FormatError

NextChunk = Callable[[int], tuple[int, list[Any]]]
"""Start and records of the first chunk at or behind a byte of the file; its checksum is checked."""


@dataclass(slots=True)
class Salvage:
    """Builder of the summary of a damaged file from its records, in their order.

    Attributes
    ----------
    summary : mcap.summary.Summary
        Channels, schemas and chunks found so far.
    records : module
        `mcap.records`.
    end : str
        Why the file could not be read to its end; empty if it could.
    known_bytes : int
        End of the last complete record.
    messages, chunks, broken : int
        Messages and chunks found, and chunks left out.
    """

    summary: Any
    records: Any
    end: str = ""
    known_bytes: int = 0
    messages: int = 0
    chunks: int = 0
    broken: int = 0

    def see(self, record: Any, end: int, next_chunk: NextChunk) -> None:
        """Add the record that ended at byte `end`."""
        behind, self.known_bytes = self.known_bytes, end
        if isinstance(record, self.records.Chunk):
            self._see_chunk(record, behind, next_chunk)
        else:
            self._see_one(record)

    def notes(self, lost_bytes: int) -> list[str]:
        """Notes on recovered and lost messages; empty for a complete file."""
        if not self.end and not self.broken:
            return []
        found = f"recovered {self.messages} messages"
        if self.end:
            found += f"; the last {lost_bytes} bytes are lost: {self.end}"
        broken = f"{self.broken} broken chunks left out, {self.chunks} are whole"
        return [found, *([broken] if self.broken else [])]

    def _see_one(self, record: Any) -> None:
        if isinstance(record, self.records.Schema):
            self.summary.schemas[record.id] = record
        elif isinstance(record, self.records.Channel):
            self.summary.channels[record.id] = record
        elif isinstance(record, self.records.Message):
            self.messages += 1

    def _see_chunk(self, chunk: Any, behind: int, next_chunk: NextChunk) -> None:
        try:
            offset, inside = next_chunk(behind)
        except FormatError:
            self.broken += 1
            return
        self.chunks += 1
        for record in inside:
            self._see_one(record)
        index = self.records.ChunkIndex(
            chunk_length=self.known_bytes - offset,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        self.summary.chunk_indexes.append(index)
