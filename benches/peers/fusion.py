"""Time per predict and update of one target: lidar_core beside numpy, FilterPy and Stone Soup.

The same target, LiDAR and radar in turn, is filtered by an EKF with constant turn rate and
acceleration (six states), process noise constant over a step, update in Joseph form. All have to
agree on every state. The systems take turns; a time is the least CPU time of all rounds.
"""

import argparse
import json
import math
import platform
import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from turns import processor

import lidar_core as lc

Array = NDArray[np.float64]
ROWS, STEP = 1224, 0.05
LIDAR, RADAR = np.diag([0.0225, 0.0225]), np.diag([0.09, 0.0009, 0.09])
PRIOR = np.diag([0.5, 0.5, 25.0, 3.0, 1.0, 9.0])
JERK, TURN = 2.0, 0.5
AGREEMENT = 1e-6
"""Largest difference of two states, beside 1 and the state."""
TRACKS = 200
"""Of a batch."""
CONFIG = lc.fusion.FusionConfig.load(
    {
        "model": "ctra",
        "process": "discrete",
        "jerk_noise": JERK,
        "turn_noise": TURN,
        "start_rows": 1,
        "gate_probability": None,
        "loss_ratio": None,
        "sensor_noise": "configured",
        "buffer_time": 0.0,
        "initial_position": 0.5**0.5,
        "initial_speed": 5.0,
        "initial_heading": 3.0**0.5,
        "initial_turn_rate": 1.0,
        "initial_acceleration": 3.0,
    }
)


def recording(seed: int) -> list[tuple[bool, Array]]:
    """Whether a row is of the LiDAR, and its values; the target goes round in a wide circle."""
    rng, rows = np.random.default_rng(seed), []
    for row in range(ROWS):
        turned = 0.3 * row * STEP
        place = np.array([8 + 5 * math.sin(turned), 3 - 5 * math.cos(turned)])
        if row % 2 == 0:
            rows.append((True, place + 0.15 * rng.normal(size=2)))
            continue
        speed = 1.5 * np.array([math.cos(turned), math.sin(turned)])
        distance = math.hypot(*place)
        exact = [distance, math.atan2(place[1], place[0]), float(place @ speed) / distance]
        rows.append((False, np.array(exact) + rng.normal(size=3) * [0.3, 0.03, 0.3]))
    return rows


def moments(rate: float, dt: float) -> list[tuple[float, float]]:
    """Integrals of t^k cos(w t) and t^k sin(w t) over a step, k = 0, 1, 2."""
    u = rate * dt
    if abs(u) < 1e-2:  # Taylor series, to 1e-16
        return [
            (
                dt ** (k + 1)
                * sum((-u * u) ** j / math.factorial(2 * j) / (2 * j + k + 1) for j in range(4)),
                dt ** (k + 1)
                * u
                * sum(
                    (-u * u) ** j / math.factorial(2 * j + 1) / (2 * j + k + 2) for j in range(4)
                ),
            )
            for k in range(3)
        ]
    s, c = math.sin(u), math.cos(u)
    a0, b0 = s / rate, (1 - c) / rate
    a1, b1 = (dt * s - b0) / rate, (a0 - dt * c) / rate
    return [(a0, b0), (a1, b1), ((dt * dt * s - 2 * b1) / rate, (2 * a1 - dt * dt * c) / rate)]


def moved(s: Array, dt: float) -> tuple[Array, Array]:
    """The state after a step, and its Jacobian."""
    x, y, v, heading, w, a = s.tolist()
    c, q = math.cos(heading), math.sin(heading)
    (A, B), (C, D), (G, H) = ((e * c - f * q, e * q + f * c) for e, f in moments(w, dt))
    F = np.eye(6)
    F[0, 2:] = A, -v * B - a * D, -v * D - a * H, C
    F[1, 2:] = B, v * A + a * C, v * C + a * G, D
    F[2, 5] = F[3, 4] = dt
    return np.array([x + v * A + a * C, y + v * B + a * D, v + a * dt, heading + w * dt, w, a]), F


def noise(s: Array, dt: float) -> Array:
    """Covariance of what a step adds."""
    c, q = math.cos(s[3]), math.sin(s[3])
    G = np.zeros((6, 2))
    G[:, 0] = dt**3 / 6 * c, dt**3 / 6 * q, dt * dt / 2, 0, 0, dt
    G[3:5, 1] = dt * dt / 2, dt
    G *= (JERK, TURN)
    return np.asarray(G @ G.T)


def place(s: Array) -> tuple[Array, Array]:
    """What a LiDAR would say, and its Jacobian."""
    return s[:2], np.eye(2, 6)


def polar(s: Array) -> tuple[Array, Array]:
    """What a radar would say, and its Jacobian."""
    x, y, v, heading = s[:4].tolist()
    c, q = math.cos(heading), math.sin(heading)
    rho = math.hypot(x, y)
    rate, across = v * (x * c + y * q) / rho, v * (x * q - y * c) / rho**3
    H = np.zeros((3, 6))
    H[0, :2] = x / rho, y / rho
    H[1, :2] = -y / rho**2, x / rho**2
    H[2, :4] = -y * across, x * across, (x * c + y * q) / rho, v * (y * c - x * q) / rho
    return np.array([rho, math.atan2(y, x), rate]), H


def wrapped(angle: float) -> float:
    """`angle` moved into -pi to pi."""
    return math.remainder(angle, 2 * math.pi)


def numpy_loop(rows: list[tuple[bool, Array]]) -> Array:
    """The reference: plain numpy."""
    s, P = np.array([*rows[0][1], 0.0, 0.0, 0.0, 0.0]), PRIOR.copy()
    found, eye = [s], np.eye(6)
    for is_lidar, z in rows[1:]:
        Q = noise(s, STEP)
        s, F = moved(s, STEP)
        P = F @ P @ F.T + Q
        expected, H = place(s) if is_lidar else polar(s)
        R, y = (LIDAR if is_lidar else RADAR), z - expected
        if not is_lidar:
            y[1] = wrapped(y[1])
        PHt = P @ H.T
        K = np.linalg.solve(H @ PHt + R, PHt.T).T
        s = s + K @ y
        left = eye - K @ H
        P = left @ P @ left.T + K @ R @ K.T
        found.append(s)
    return np.array(found)


def filterpy_loop(rows: list[tuple[bool, Array]]) -> Array:
    """FilterPy's ExtendedKalmanFilter, its state predicted by the model."""
    from filterpy.kalman import ExtendedKalmanFilter

    class Ctra(ExtendedKalmanFilter):  # type: ignore[misc]
        def predict_x(self, u: object = 0) -> None:
            self.x, self.F = moved(self.x, STEP)

    def minus(a: Array, b: Array) -> Array:
        y = a - b
        y[1] = wrapped(y[1])
        return y

    ekf = Ctra(dim_x=6, dim_z=3)
    ekf.x, ekf.P = np.array([*rows[0][1], 0.0, 0.0, 0.0, 0.0]), PRIOR.copy()
    found = [ekf.x]
    for is_lidar, z in rows[1:]:
        ekf.Q = noise(ekf.x, STEP)
        ekf.predict()
        h, R = (place, LIDAR) if is_lidar else (polar, RADAR)
        ekf.update(
            z,
            lambda s, h=h: h(s)[1],
            lambda s, h=h: h(s)[0],
            R=R,
            residual=np.subtract if is_lidar else minus,
        )
        found.append(ekf.x)
    return np.array(found)


def stonesoup_loop(rows: list[tuple[bool, Array]]) -> Array:
    """Stone Soup's extended predictor and updater, with models of its kind."""
    from stonesoup.base import Property
    from stonesoup.models.base import GaussianModel
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    def flat(state: Any) -> Array:
        return np.asarray(state.state_vector, np.float64).ravel()

    class Ctra(TransitionModel, GaussianModel):  # type: ignore[misc]
        @property
        def ndim_state(self) -> int:
            return 6

        def function(self, state: Any, noise: Any = None, **kwargs: Any) -> Any:
            return StateVector(moved(flat(state), STEP)[0])

        def jacobian(self, state: Any, **kwargs: Any) -> Array:
            return moved(flat(state), STEP)[1]

        def covar(self, time_interval: Any = None, *, prior: Any = None, **kwargs: Any) -> Any:
            return CovarianceMatrix(self.added)

        # Stone Soup wants these to be there; a filter never calls them.
        def rvs(self, *args: Any, **kwargs: Any) -> Any:
            raise NotImplementedError

        def pdf(self, *args: Any, **kwargs: Any) -> Any:
            raise NotImplementedError

    class Sensor(NonLinearGaussianMeasurement):  # type: ignore[misc]
        ndim_state: int = Property(default=6)
        mapping: Any = Property(default=(0, 1))
        is_lidar: bool = Property(default=True)

        @property
        def ndim_meas(self) -> int:
            return 2 if self.is_lidar else 3

        def function(self, state: Any, noise: Any = None, **kwargs: Any) -> Any:
            if self.is_lidar:
                return StateVector(place(flat(state))[0])
            rho, bearing, rate = polar(flat(state))[0]
            return StateVector([[rho], [Bearing(bearing)], [rate]])

        def jacobian(self, state: Any, **kwargs: Any) -> Array:
            return (place if self.is_lidar else polar)(flat(state))[1]

        def inverse_function(self, *args: Any, **kwargs: Any) -> Any:
            raise NotImplementedError

    model = Ctra()
    sensors = [
        Sensor(noise_covar=CovarianceMatrix(RADAR), is_lidar=False),
        Sensor(noise_covar=CovarianceMatrix(LIDAR), is_lidar=True),
    ]
    predictor, updater = ExtendedKalmanPredictor(model), ExtendedKalmanUpdater(use_joseph_cov=True)
    start = datetime(2026, 1, 1)
    first = StateVector([*rows[0][1], 0.0, 0.0, 0.0, 0.0])
    state: Any = GaussianState(first, CovarianceMatrix(PRIOR), timestamp=start)
    found = [flat(state)]
    for number, (is_lidar, z) in enumerate(rows[1:], 1):
        stamp = start + timedelta(seconds=number * STEP)
        model.added = noise(flat(state), STEP)
        predicted = predictor.predict(state, timestamp=stamp)
        seen = StateVector(z) if is_lidar else StateVector([[z[0]], [Bearing(z[1])], [z[2]]])
        detection = Detection(seen, timestamp=stamp, measurement_model=sensors[is_lidar])
        state = updater.update(SingleHypothesis(predicted, detection))
        found.append(flat(state))
    return np.array(found)


def ours(rows: list[tuple[bool, Array]]) -> dict[str, tuple[Callable[[], Any], int]]:
    """One call per measurement, and one for many tracks."""
    seen = [
        lc.fusion.Measurement(round(k * STEP * 1e9), "lidar" if is_lidar else "radar", z)
        for k, (is_lidar, z) in enumerate(rows)
    ]
    tracks = [lc.fusion.Measurements(seen) for _ in range(TRACKS)]

    def steps() -> list[Any]:
        target = lc.fusion.TargetFilter(CONFIG)
        return [target.step(m) for m in seen]

    def batch() -> Array:
        return lc.fusion.run_batch(tracks, CONFIG, threads=1)[-1].states

    return {"lidar_core, `step`": (steps, 1), f"lidar_core, batch of {TRACKS}": (batch, TRACKS)}


def main() -> None:
    """Measure, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9, help="rounds; the best counts")
    parser.add_argument("--figures", type=Path, help="JSON file for the numbers")
    chosen = parser.parse_args()
    rounds = chosen.rounds
    rows = recording(0)
    systems: dict[str, tuple[Callable[[], Any], int]] = {
        "numpy, plain loop": (lambda: numpy_loop(rows), 1),
        f"FilterPy {version('filterpy')}": (lambda: filterpy_loop(rows), 1),
        f"Stone Soup {version('stonesoup')}": (lambda: stonesoup_loop(rows), 1),
        **ours(rows),
    }
    best = dict.fromkeys(systems, math.inf)
    expected = numpy_loop(rows)
    for number in range(rounds):
        for name, (run, tracks) in systems.items():
            start = process_time()
            states = run()
            spent = (process_time() - start) / tracks / (ROWS - 1) * 1e6
            best[name] = min(best[name], spent)
            if number == 0:
                check(name, states, expected)
    reference = best["numpy, plain loop"]
    print("| system | us per predict and update | of the reference |\n|---|---|---|")
    for name, spent in best.items():
        print(f"| {name} | {spent:.3g} | {spent / reference:.3g} |")
    if chosen.figures:
        figures = {
            name: {"place": place, "us": spent, "of_numpy": spent / reference}
            for place, (name, spent) in enumerate(best.items())
        }
        chosen.figures.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    print(
        f"\n{processor()}, Python {platform.python_version()}, numpy {version('numpy')},"
        f" lidar_core {lc.__version__}; best of {rounds} rounds, one thread."
    )


def check(name: str, found: Any, expected: Array) -> None:
    """Stop unless all states agree."""
    states = np.array([one.state for one in found]) if isinstance(found, list) else found
    away = states - expected
    away[:, 3] = np.vectorize(wrapped)(away[:, 3])
    if not np.allclose(away, 0, atol=AGREEMENT * (1 + np.abs(expected).max())):
        sys.exit(f"{name} disagrees with the reference by {np.abs(away).max():g}")


if __name__ == "__main__":
    main()
