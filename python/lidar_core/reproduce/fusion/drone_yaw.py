"""`fusion-drone-yaw`: tracks while the sensor itself turns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import nees
from lidar_core.fusion import FusionConfig, Measurement, fit_noise, run_batch
from lidar_core.fusion.recordings.reading import TargetTruth
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.fusion.contenders import FIXED
from lidar_core.reproduce.fusion.laser_radar import (
    OBJ_POSE,
    course,
    in_turn,
    measured,
    measurements,
)
from lidar_core.reproduce.fusion.rmse import SETTLED
from lidar_core.reproduce.types import Item, Measured, Request, Row

MOTIONS = ((0.0, 0.0), (0.3, 0.0), (1.0, 0.0), (1.0, 3.0))
"""Greatest turn rate [rad/s], to and fro, and speed ahead [m/s] of the platform."""
SWING = 4.0
"""Time until it turns the other way [s]."""
GYRO_STD = 0.01
"""Of the turn rate that the gyro says [rad/s]."""
FAULTS = (0.1, 0.05)
"""Bias [rad/s] of a gyro that nobody has calibrated, and time by which its stamps are late [s]."""
STARTED = 10.0
"""Time from which errors with such a gyro count [s]."""
PRINTED, IGNORED, BEST = "equations as printed", "motion ignored", "gyro told"
ESTIMATED = "bias and delay of the gyro estimated"
STYLES = {
    PRINTED: (RED, ":"),
    IGNORED: (RED, "-"),
    "gyro measured": (GREY, "-"),
    "no gyro": (GREY, "--"),
    ESTIMATED: (BLUE, ":"),
    BEST: (BLUE, "-"),
}


@dataclass(frozen=True, slots=True)
class Ride:
    """Motion of the sensor, one row per row of the recording.

    Attributes
    ----------
    greatest : float
        Greatest turn rate [rad/s].
    speed : ndarray, shape (K,)
        Speed ahead from each row to the next [m/s].
    yaw : ndarray, shape (K,)
        Heading at each row [rad].
    position : ndarray, shape (K, 2)
        Place at each row [m].
    """

    greatest: float
    speed: NDArray[np.float64]
    yaw: NDArray[np.float64]
    position: NDArray[np.float64]

    @classmethod
    def of(cls, seconds: NDArray[np.float64], rate: float, speed: float) -> "Ride":
        """Make a path of arcs on which the sensor swings like a pendulum."""
        swings = np.pi / SWING
        yaw = rate / swings * np.sin(swings * seconds)
        steps = np.diff(seconds, append=2 * seconds[-1] - seconds[-2])
        turns = np.diff(yaw, append=rate / swings * np.sin(swings * (seconds[-1] + steps[-1])))
        # the chord of an arc: sin(u)/u of its length, ahead at its middle
        chord = speed * steps * np.sinc(turns / 2 / np.pi)
        legs = chord[:, None] * np.stack([np.cos(yaw + turns / 2), np.sin(yaw + turns / 2)], axis=1)
        return cls(rate, np.full(len(yaw), speed), yaw, np.cumsum(legs, axis=0) - legs)

    def gyro(
        self, seconds: NDArray[np.float64], bias: float = 0.0, delay: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the turn rate [rad/s] that a gyro reads at the times `seconds` [s].

        `bias` [rad/s] is added, and the reading is `delay` [s] old.
        """
        return self.greatest * np.cos(np.pi / SWING * (seconds - delay)) + bias

    def relative(self, truth: TargetTruth) -> TargetTruth:
        """Return the truth in the sensor's frame: position, and velocity relative to the sensor."""
        ahead = np.stack([np.cos(self.yaw), np.sin(self.yaw)], axis=1)
        own = self.speed[:, None] * ahead
        place = turned_back(truth.position - self.position, ahead)
        return TargetTruth(
            truth.stamps_ns, place, turned_back(truth.velocity - own, ahead), None, None
        )


def turned_back(vectors: NDArray[np.float64], ahead: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate vectors (..., 2) into axes whose first axis is the unit vector `ahead`."""
    x, y, c, s = vectors[..., 0], vectors[..., 1], ahead[..., 0], ahead[..., 1]
    return np.stack([c * x + s * y, c * y - s * x], axis=-1)


def configs() -> dict[str, FusionConfig]:
    """Return filters that differ in what they know about the sensor's motion.

    Their process noise is the most likely one for the unchanged recording; the noise of the sensors
    is known.
    """
    of = course(OBJ_POSE)
    begin = FusionConfig(model="ctrv", acceleration_noise=1.0)
    fitted = fit_noise(measurements(of, of.values, "fixed", FIXED, 0.0), begin, sensors=False)
    open_gates = {
        "gate_probability": None,
        "loss_ratio": None,
        "sensor_noise": "configured",
    }

    def drone(gyro: str) -> FusionConfig:
        changes = {
            "model": "ctrv-drone",
            "gyro": gyro,
            "gyro_std": GYRO_STD,
            "sensor_noise": "configured",
        }
        return FusionConfig.load(fitted.model_dump() | changes)

    return {
        PRINTED: FusionConfig.paper(),
        IGNORED: FusionConfig.load(fitted.model_dump() | open_gates),
        "no gyro": drone("none"),
        "gyro measured": drone("measurement"),
        ESTIMATED: drone("input"),
        BEST: drone("exact"),
    }


def _measure(request: Request) -> Measured:
    filters = configs()
    found = {motion: _errors(motion, filters, request) for motion in MOTIONS}
    told = {name: filters[name] for name in (ESTIMATED, BEST)}
    late = {motion: _late(motion, told, request) for motion in MOTIONS}
    request.advance(request.scans)
    return Measured(
        (found, late),
        scans=request.scans,
        note=f"Measurements drawn anew along the true way of obj_pose, seen by a sensor that turns"
        f" to and fro every {SWING:g} s; errors in its own frame, without the first {SETTLED}"
        f" rows. The gyro reads the turn rate at the time of every row; its error is {GYRO_STD:g}"
        f" rad/s, which is told. As delivered it is also {FAULTS[0]:g} rad/s wrong and"
        f" {FAULTS[1]:g} s late, of which nothing is told, and errors count after {STARTED:g} s."
        " The paper has no number for this.",
        config=filters,
    )


def _errors(
    motion: tuple[float, float], filters: Mapping[str, FusionConfig], request: Request
) -> dict[str, NDArray[np.float64]]:
    """Root mean square errors of x and y over all draws, by filter."""
    seen, targets = _targets(motion, request, (0.0, 0.0))
    found = {}
    for name, config in filters.items():
        skip = 2 if name in (PRINTED, IGNORED) else 1
        own = [target[skip - 1 :: skip] for target in targets]
        runs = run_batch(own, config, threads=request.threads)
        states = np.array([one.states[2 - skip :: 3 - skip, :2] for one in runs])
        wrong = (states - seen.position)[:, SETTLED:]
        found[name] = np.sqrt(np.square(wrong).mean(axis=(0, 1)))
    return found


def _late(
    motion: tuple[float, float], filters: Mapping[str, FusionConfig], request: Request
) -> dict[str, tuple[float, float]]:
    """RMSE in the plane [m] and NEES / 2 of the position, by filter, for a gyro with faults."""
    seen, targets = _targets(motion, request, FAULTS)
    kept = seen.stamps_ns > seen.stamps_ns[0] + STARTED * 1e9
    found = {}
    for name, config in filters.items():
        runs = run_batch(targets, config, threads=request.threads)
        wrong = (np.array([one.states[1::2, :2] for one in runs]) - seen.position)[:, kept]
        spread = np.array([one.covariances[1::2, :2, :2] for one in runs])[:, kept]
        error = float(np.sqrt(np.square(wrong).sum(axis=2).mean()))
        found[name] = (error, float(nees(wrong, spread).mean()) / 2)
    return found


def _targets(
    motion: tuple[float, float], request: Request, faults: tuple[float, float]
) -> tuple[TargetTruth, list[list[Measurement]]]:
    """Return the truth in the frame of the sensor, and draws of the measurements."""
    truth = course(OBJ_POSE).truth
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    ride = Ride.of(seconds, *motion)
    seen = ride.relative(truth)
    targets = []
    for number in range(request.scans):
        rng = np.random.default_rng([20230702, request.seed, number, round(10 * sum(motion))])
        values = measured(seen, FIXED, rng)
        rates = ride.gyro(seconds, *faults) + GYRO_STD * rng.normal(size=len(seconds))
        targets.append(_measurements(values, seen, ride.speed, rates))
    return seen, targets


def _measurements(
    values: NDArray[np.float64],
    seen: TargetTruth,
    speed: NDArray[np.float64],
    rates: NDArray[np.float64],
) -> list[Measurement]:
    """Measurements in order of time, each after the gyro reading of the same time."""
    told: list[Measurement] = []
    stamps, is_lidar = seen.stamps_ns.tolist(), in_turn(len(values))
    for row, stamp_ns in enumerate(stamps):
        told.append(Measurement(stamp_ns, "gyro", [rates[row], speed[row], 0.0]))
        if is_lidar[row]:
            told.append(Measurement(stamp_ns, "lidar", values[row, :2]))
        else:
            told.append(Measurement(stamp_ns, "radar", values[row]))
    return told


Found = Mapping[tuple[float, float], Mapping[str, NDArray[np.float64]]]
Late = Mapping[tuple[float, float], Mapping[str, tuple[float, float]]]


def _name(motion: Sequence[float]) -> str:
    rate, speed = motion
    return f"{rate:g}rad/s" + (f", {speed:g} m/s ahead" if speed else "")


def _rows(found: Found, late: Late) -> list[Row]:
    """Rows: errors per axis, their ratio to a sensor at rest, errors for a gyro with faults."""
    rows = []
    for motion, errors in found.items():
        for axis, name in enumerate("xy"):
            values = {who: float(error[axis]) for who, error in errors.items()}
            at = f"RMSE of {name}@{_name(motion)}"
            rows.append(Row(at, "m", None, values[PRINTED], values[BEST]))
            rows.append(Row(f"{at}, {IGNORED}", "m", equations_corrected=values[IGNORED]))
            rows += [
                Row(f"{at}, {who}", "m", None, None, values[who])
                for who in ("gyro measured", "no gyro", ESTIMATED)
            ]
    rest = {who: np.hypot(*error) for who, error in found[MOTIONS[0]].items()}
    for motion in MOTIONS[1:]:
        ratio = {who: float(np.hypot(*error) / rest[who]) for who, error in found[motion].items()}
        rows.append(
            Row(
                f"2-D RMSE over that at rest@{_name(motion)}",
                "1",
                None,
                ratio[PRINTED],
                ratio[BEST],
            )
        )
    still = late[MOTIONS[0]][ESTIMATED][0]
    for motion, told in late.items():
        at = f"@{_name(motion)}, gyro as delivered"
        error, spread = told[ESTIMATED]
        rows += [
            Row(f"2-D RMSE{at}", "m", None, None, error),
            Row(f"2-D RMSE{at}, believed", "m", None, None, told[BEST][0]),
            Row(f"2-D RMSE over that at rest{at}", "1", None, None, error / still),
            Row(f"NEES / 2{at}", "1", None, None, spread),
        ]
    return rows


def _draw(figure: Any, found: Found, late: Late) -> None:
    """Draw the position errors in the plane over the motion of the sensor."""
    panel = figure.subplots()
    spots = list(range(len(found)))
    for who, (colour, line) in STYLES.items():
        values = [float(np.hypot(*errors[who])) for errors in found.values()]
        panel.plot(spots, values, line, color=colour, marker="o", label=who)
    panel.set_xticks(spots, [_name(motion) for motion in found])
    panel.set(
        xlabel="turn rate of the sensor, to and fro", ylabel="RMSE in the plane [m]", yscale="log"
    )
    panel.legend()


ITEM = Item(
    name="fusion-drone-yaw",
    title="LiDAR and radar on a sensor that turns: ignored, as published, correct",
    scans=40,
    minutes=0.5,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="y",
    heading="A sensor that turns",
    counts="draws",
    data=(OBJ_POSE,),
)
