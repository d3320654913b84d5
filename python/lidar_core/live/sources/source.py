"""Where live messages come from."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from lidar_core.io.records import Findings
from lidar_core.live.sources.inbox import Inbox


@dataclass(frozen=True, slots=True)
class StreamTopics:
    """What is wanted of a stream.

    Attributes
    ----------
    clouds, scans : tuple of str
        Topics of LiDARs in 3D and in 2D that were named.
    wants_clouds, wants_scans : bool
        Whether topics of that sort are wanted at all.
    odometry : str, optional
        Topic of the poses that was named.
    """

    clouds: tuple[str, ...] = ()
    scans: tuple[str, ...] = ()
    wants_clouds: bool = True
    wants_scans: bool = True
    odometry: str | None = None


class Source(ABC):
    """Puts records into an inbox, from threads of its own, between `start` and `close`.

    Attributes
    ----------
    name : str
        Where it listens, for people.
    findings : Findings
        What its decoders detected and rejected.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.findings = Findings()

    @abstractmethod
    def start(self, inbox: Inbox) -> None:
        """Begin to listen.

        Raises
        ------
        LinkError
            The broker or server cannot be reached.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop; no record comes afterwards."""

    def trouble(self) -> str:
        """What it waits for, in words; empty while connected."""
        return ""

    def advertised(self) -> list[str]:
        """What is there to listen to, each with its type; empty where nobody tells."""
        return []

    @property
    def is_linked(self) -> bool:
        """Whether the broker or server is there."""
        return True

    @property
    def is_stream(self) -> bool:
        """Whether nothing may ever come, because nobody knows beforehand what will."""
        return True

    def lead_ns(self, stamp_ns: int) -> int:
        """What has to be added to a stamp to get the time at which it was due here [ns]."""
        del stamp_ns  # stamps of live sources are times of this clock
        return 0
