"""Loop of a live run: scans wait for a pose, pass the pipeline, and go to the outputs."""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic

from lidar_core.errors import FormatError, LidarCoreError
from lidar_core.io import NoTransformError, PosedScan
from lidar_core.live.config import MAX_POSES, REPORT_INTERVAL, LiveConfig
from lidar_core.live.outputs.output import Output
from lidar_core.live.pipelines import LivePipeline
from lidar_core.live.poses import LivePoses
from lidar_core.live.sources.inbox import Arrival, Batch, Inbox
from lidar_core.live.sources.source import Source
from lidar_core.live.stats import LiveStats, Report, within_limit
from lidar_core.live.tape import Tape
from lidar_core.messages import Message, Pose, ScanT
from lidar_core.util.reasons import first_of_kind

IDLE_S = 0.05  # longest sleep while nothing arrives
SILENCE_S = 1.2  # without a scan, after which is told what there is instead
CLOCK_JUMP_S = 5.0  # a scan that is older than the newest by more is not late: its clock jumped


@dataclass(frozen=True, slots=True)
class _Waiting(Generic[ScanT]):
    scan: ScanT
    arrival_ns: int


class LiveLoop(Generic[ScanT]):
    """Loop that processes scans of a source: always the newest one that has a pose.

    Parameters
    ----------
    source : Source
        Started by `run`, and closed.
    pipeline : callable
        Called with a kind of scans; makes its pipeline, or returns None for an unwanted kind.
    poses : LivePoses
        Source of the sensor's poses.
    outputs : sequence of Output
        Outputs that get every update, in this order; closed at the end.
    config : LiveConfig
        Waiting times.
    topics : sequence of str
        Topics of the LiDARs; empty for the first one with a scan.
    tape : Tape, optional
        Writer that gets everything that arrives.
    on_report : callable
        Called with a report every second.
    on_silence : callable
        Called once if no wanted scan comes in the first seconds, with the topics that the source
        has.
    on_reason : callable
        Called with every reason why scans are not processed, when it first occurs.

    Attributes
    ----------
    stats : LiveStats
        Counts of the run.
    inbox : Inbox
        Messages that have arrived.
    """

    def __init__(
        self,
        source: Source,
        pipeline: Callable[[type], LivePipeline[ScanT] | None],
        poses: LivePoses,
        outputs: Sequence[Output],
        config: LiveConfig,
        *,
        topics: Sequence[str] = (),
        tape: Tape | None = None,
        on_report: Callable[[Report], None] = lambda report: None,
        on_silence: Callable[[list[str]], None] = lambda advertised: None,
        on_reason: Callable[[str], None] = lambda reason: None,
    ) -> None:
        self.stats = LiveStats()
        self.inbox = Inbox(max_poses=MAX_POSES, tape=tape)
        self.pipeline: LivePipeline[ScanT] | None = None
        self._source = source
        self._make: Callable[[type], LivePipeline[ScanT] | None] = pipeline
        self._poses, self._outputs, self._config = poses, outputs, config
        self._topics = set(topics)
        self._waiting: dict[str, deque[_Waiting[ScanT]]] = {}
        self._frame, self._is_ready = "", False
        self._objects = 0
        self._processed_ns: dict[str, int] = {}  # newest processed scan of each topic
        self._on_report, self._on_silence, self._on_reason = on_report, on_silence, on_reason
        self._is_silence_told = False
        self._wanted = frozenset(topics)
        self._began = self._reported = self._linked_at = time.monotonic()
        self._reported_scans = 0

    def run(self, seconds: float | None = None) -> None:
        """Work until the source ends, for a number of seconds, or until Ctrl-C, which is raised.

        Raises
        ------
        LinkError
            The source cannot be reached.
        """
        self._began = self._reported = time.monotonic()
        try:
            self._source.start(self.inbox)
            self._linked_at = time.monotonic()
            is_finished = False
            while not (is_finished and (not self._is_ready or not any(self._waiting.values()))):
                batch = self.inbox.take(IDLE_S)
                is_finished = batch.is_finished
                self._read(batch)
                self._process_next()
                self._report_if_due()
                self._tell_of_silence()
                if seconds is not None and time.monotonic() - self._began >= seconds:
                    return
        finally:
            self._source.close()

    @property
    def heard_nothing(self) -> bool:
        """True if a stream brought none of the requested scans, not even an unreadable one."""
        heard = self.inbox.heard & self._wanted if self._wanted else self.inbox.heard
        return self._source.is_stream and not heard

    def _tell_of_silence(self) -> None:
        """Report once which topics the source has if no wanted scan arrives."""
        if self._is_silence_told or not self.heard_nothing:
            return
        now = time.monotonic()
        if not self._source.is_linked:
            self._linked_at = now
        elif now - self._linked_at >= SILENCE_S:
            self._is_silence_told = True
            self._on_silence(self._source.advertised())

    def summary(self) -> dict[str, Any]:
        """Return the results of the run as plain values."""
        self.stats.dropped.update(self.inbox.dropped)
        self.inbox.dropped.clear()
        findings = self._source.findings
        rejected = findings.rejected + self.inbox.rejected
        return {
            "source": self._source.name,
            "capability": None if self.pipeline is None else self.pipeline.capability,
            "frame_id": self._poses.fixed_frame,
            "seconds": time.monotonic() - self._began,
            **self.stats.summary(),
            "bad_messages": dict(rejected),
            "notes": list(findings.notes),
        }

    def _read(self, batch: Batch) -> None:
        for reason in batch.refused:
            self._reject(reason)
        for arrival in batch.poses:
            self._file(arrival, self._decoded(arrival))
        for arrival in batch.scans:
            self._file(arrival, self._decoded(arrival))

    def _decoded(self, arrival: Arrival) -> list[Message]:
        """Decode the messages of a record; if it cannot be read, count it and return none."""
        topic = arrival.record.topic.name
        if self._topics and self._is_ignored(arrival):
            return []
        try:
            return arrival.record.decode()
        except LidarCoreError as error:
            self.inbox.reject(topic)
            self._source.findings.note(str(error))
            return []

    def _is_ignored(self, arrival: Arrival) -> bool:
        """Return whether it is a scan of a topic that was not requested; count it if so."""
        topic = arrival.record.topic
        is_ignored = topic.kind in ("scan", "planar") and topic.name not in self._topics
        if is_ignored:
            self.stats.ignored[within_limit(self.stats.ignored, topic.name)] += 1
        return is_ignored

    def _file(self, arrival: Arrival, messages: list[Message]) -> None:
        """Add poses to the poses and scans to the waiting scans."""
        for message in messages:
            if isinstance(message, Pose):
                self._poses.add(arrival.record.topic, message, self._frame)
                continue
            if self.pipeline is None:
                self.pipeline = self._make(type(message))
            if self.pipeline is None or not isinstance(message, self.pipeline.sort):
                self.stats.ignored[within_limit(self.stats.ignored, message.topic)] += 1
                continue
            self._enqueue(self.pipeline, message, arrival)

    def _enqueue(self, pipeline: LivePipeline[ScanT], scan: ScanT, arrival: Arrival) -> None:
        topic = arrival.record.topic.name
        if not self._topics:
            self._topics = {topic}
        if topic not in self._topics:
            self.stats.ignored[within_limit(self.stats.ignored, topic)] += 1
            return
        try:
            self._is_ready = pipeline.is_ready(scan)
        except FormatError as error:
            self._reject(str(error))
            return
        self._frame = scan.frame_id
        queue = self._waiting.setdefault(topic, deque())
        queue.append(_Waiting(scan, arrival.time_ns))
        if len(queue) > self._config.max_waiting:
            self._drop(topic, 1)

    def _process_next(self) -> None:
        """Process the newest scan of each topic that has its pose, oldest topic first."""
        pipeline = self.pipeline
        if pipeline is None or not self._is_ready:
            return
        ready = [item for topic in self._waiting if (item := self._newest(topic)) is not None]
        for waiting, posed in sorted(ready, key=lambda item: item[0].scan.stamp_ns):
            self._process(pipeline, waiting, posed)

    def _newest(self, topic: str) -> tuple[_Waiting[ScanT], PosedScan[ScanT]] | None:
        """Return the newest scan of a topic whose pose is known, or None; drop older scans.

        A scan that waits longer than `pose_wait` is dropped if there is a newer one.
        """
        queue, now_ns = self._waiting[topic], time.time_ns()
        for place in reversed(range(len(queue))):
            waiting = queue[place]
            is_late = now_ns - waiting.arrival_ns > self._config.pose_wait * 1e9
            if is_late and place < len(queue) - 1:
                for _ in range(place + 1):
                    self._give_up(topic)
                return None
            if not is_late and not self._poses.is_complete(waiting.scan):
                continue
            self._drop(topic, place)
            queue.popleft()
            try:
                return waiting, self._poses.posed(waiting.scan)
            except NoTransformError as error:
                self._count(self.stats.without_pose, self._told(waiting.scan, str(error)))
                return None
        return None

    def _give_up(self, topic: str) -> None:
        """Drop and count the oldest scan of a topic, whose pose did not arrive in time."""
        waiting = self._waiting[topic].popleft()
        try:
            self._poses.posed(waiting.scan)
        except NoTransformError as error:
            self._count(self.stats.without_pose, self._told(waiting.scan, str(error)))
        else:
            self.stats.dropped[topic] += 1

    def _drop(self, topic: str, count: int) -> None:
        """Drop and count the `count` oldest waiting scans of a topic."""
        for _ in range(count):
            self._waiting[topic].popleft()
        if count:
            self.stats.dropped[topic] += count

    def _process(
        self, pipeline: LivePipeline[ScanT], waiting: _Waiting[ScanT], posed: PosedScan[ScanT]
    ) -> None:
        update = pipeline.take(posed, self._poses.fixed_frame)
        if isinstance(update, str):
            self._reject(self._told(waiting.scan, update))
            return
        scan = waiting.scan
        self._processed_ns[scan.topic] = max(
            scan.stamp_ns, self._processed_ns.get(scan.topic, scan.stamp_ns)
        )
        for output in self._outputs:
            try:
                output.publish(update)
            except LidarCoreError as error:  # such as a time that the format cannot tell
                self._reject(f"{output.name}: {error}")
        now_ns = time.time_ns()
        self._objects = len(update.objects.id)
        self.stats.processed += 1
        stamp_ns = update.stamp_ns
        self.stats.from_arrival.add(now_ns - waiting.arrival_ns)
        self.stats.from_stamp.add(now_ns - stamp_ns - self._source.lead_ns(stamp_ns))

    def _told(self, scan: ScanT, reason: str) -> str:
        """Return why a scan is not processed: the clock of its source, if that went back far."""
        back = (self._processed_ns.get(scan.topic, scan.stamp_ns) - scan.stamp_ns) * 1e-9
        if back <= CLOCK_JUMP_S:
            return reason
        return (
            f"{scan.topic or 'scans'}: the clock of the source went back by {back:.1f} s (a loop or"
            " a restart of the source): start live again"
        )

    def _reject(self, reason: str) -> None:
        self._count(self.stats.rejected, reason)

    def _count(self, reasons: Counter[str], reason: str) -> None:
        """Count a scan that is not processed, and report a reason when it first occurs.

        Later ones that differ only in their numbers, such as stamps, count as the first one.
        """
        reason = within_limit(reasons, first_of_kind(reasons, reason))
        if reason not in reasons:
            self._on_reason(reason)
        reasons[reason] += 1

    def _report_if_due(self) -> None:
        now = time.monotonic()
        passed = now - self._reported
        if passed < REPORT_INTERVAL:
            return
        counts = self.stats.counts()
        counts["dropped"] += self.inbox.dropped.total()
        scans = self.stats.processed - self._reported_scans
        self._on_report(
            Report(
                now - self._began,
                scans / passed,
                self.stats.from_stamp.recent(),
                self.stats.from_arrival.recent(),
                counts,
                self.stats.processed,
                self._objects,
                self._source.trouble(),
            )
        )
        self._reported, self._reported_scans = now, self.stats.processed
