"""Complete messages of an MCAP file that was not closed, was truncated, or has broken chunks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lidar_core.errors import FormatError

RECORD_BYTES = 9  # operation code and length before every record
CHUNK_BYTES = 8 + 8 + 8 + 4 + 4 + 8  # of a chunk without its compression's name and its data


@dataclass(slots=True)
class Salvage:
    """Fills a summary from the records of a file, in their order.

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

    def see(self, record: Any, end: int, whole_chunk: Callable[[int], list[Any]]) -> None:
        """Take the record that ended at byte `end`; `whole_chunk` reads and checks a chunk."""
        self.known_bytes = end
        if isinstance(record, self.records.Chunk):
            self._see_chunk(record, end, whole_chunk)
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

    def _see_chunk(self, chunk: Any, end: int, whole_chunk: Callable[[int], list[Any]]) -> None:
        length = CHUNK_BYTES + len(chunk.compression.encode()) + len(chunk.data)
        offset = end - length - RECORD_BYTES
        try:
            inside = whole_chunk(offset)
        except FormatError:
            self.broken += 1
            return
        self.chunks += 1
        for record in inside:
            self._see_one(record)
        index = self.records.ChunkIndex(
            chunk_length=length + RECORD_BYTES,
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
