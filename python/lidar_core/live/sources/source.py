"""Interface of sources of live messages."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from lidar_core.io.records import Findings
from lidar_core.live.sources.inbox import Inbox

__all__ = ["Source", "StreamTopics"]


@dataclass(frozen=True, slots=True)
class StreamTopics:
    """Topics that are requested from a stream.

    Attributes
    ----------
    clouds, scans : tuple of str
        Topics of LiDARs in 3D and in 2D that were named.
    wants_clouds, wants_scans : bool
        True if topics of this kind are requested.
    odometry : str, optional
        Topic of the poses that was named.
    """

    clouds: tuple[str, ...] = ()
    scans: tuple[str, ...] = ()
    wants_clouds: bool = True
    wants_scans: bool = True
    odometry: str | None = None


class Source(ABC):
    """Interface of sources, which put records into an inbox from their own threads.

    Attributes
    ----------
    name : str
        Address of the source in messages.
    findings : Findings
        Defects and rejected messages that its decoders found.
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
        """Stop; no record arrives afterwards."""

    def trouble(self) -> str:
        """Reason for waiting as text; empty while connected."""
        return ""

    def silence(self) -> str:
        """Probable reason why no scan arrived, with the remedy; empty if the topics show it."""
        return ""

    def advertised(self) -> list[str]:
        """Available topics with their types; empty if they are unknown."""
        return []

    @property
    def is_linked(self) -> bool:
        """True while the broker or server is connected."""
        return True

    @property
    def is_stream(self) -> bool:
        """True if it may never bring a message, because its content is not known in advance."""
        return True

    @property
    def has_arrivals(self) -> bool:
        """True if the times of its records are those at which the messages arrived."""
        return True

    def lead_ns(self, stamp_ns: int) -> int:
        """Time at which the message was due on this clock, minus its stamp [ns]."""
        del stamp_ns  # stamps of live sources are times of this clock
        return 0


def __dir__() -> list[str]:
    return __all__
