"""Time per scan, in total and per stage, during a run."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import Latency


class ScanTimes:
    """Collector of the processing times of the scans."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._wall_ms: list[float] = []
        self._stages_ms: dict[str, list[float]] = {}
        self._sensor: list[NDArray[np.float64]] = []

    def add(
        self,
        stamp_ns: int,
        wall_ms: float,
        stages_ms: Mapping[str, float],
        place: NDArray[np.float64],
    ) -> None:
        """Append one scan with the place of its sensor; all of them have the same stages."""
        self._sensor.append(place)
        self._stamps_ns.append(stamp_ns)
        self._wall_ms.append(wall_ms)
        for name, value in stages_ms.items():
            self._stages_ms.setdefault(name, []).append(value)

    @property
    def wall_ms(self) -> list[float]:
        """Time of every scan [ms]."""
        return self._wall_ms

    @property
    def places(self) -> list[NDArray[np.float64]]:
        """Place of the sensor at every scan [m]."""
        return self._sensor

    @property
    def stages_ms(self) -> list[dict[str, float]]:
        """Time of every scan per stage [ms]."""
        if not self._stages_ms:
            return [{} for _ in self._stamps_ns]
        values = zip(*self._stages_ms.values(), strict=True)
        return [dict(zip(self._stages_ms, row, strict=True)) for row in values]

    @property
    def latency(self) -> Latency | None:
        """Time per scan [ms]; None without scans."""
        return Latency.of(self._wall_ms, self._stages_ms)

    @property
    def ms_per_scan(self) -> dict[str, float]:
        """Mean time per scan, in all and per stage [ms].

        The first scan is left out, if there are more: it includes loading and setting up.
        """
        later = slice(1 if len(self._wall_ms) > 1 else 0, None)
        stages_ms = {name: values[later] for name, values in self._stages_ms.items()}
        latency = Latency.of(self._wall_ms[later], stages_ms)
        if latency is None:
            return {"total": 0.0}
        stages = {name: spread.mean for name, spread in latency.stages.items()}
        return {"total": latency.total.mean, **stages}

    def table(self) -> dict[str, Any]:
        """Columns of the timing table: times [ms] and the place of the sensor [m] per scan."""
        stages = {f"{name}_ms": np.array(values) for name, values in self._stages_ms.items()}
        stamps = np.array(self._stamps_ns, np.int64)
        sensor = np.array(self._sensor, np.float64).reshape(-1, 3)
        places = {f"sensor_{axis}": sensor[:, column] for column, axis in enumerate("xyz")}
        total = np.array(self._wall_ms, np.float64)
        return {"t_ns": stamps, "total_ms": total, **stages, **places}
