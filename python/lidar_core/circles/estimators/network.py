"""Circles by neural networks: ONNX models, run on the CPU by onnxruntime."""

import json
from ast import literal_eval
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.circles.estimators.detector_name import MODELS, shipped
from lidar_core.circles.estimators.fit_config import FitConfig
from lidar_core.circles.estimators.fitting import Circles
from lidar_core.circles.estimators.onnx_graph import check_graph
from lidar_core.circles.estimators.trust import check_trusted, content_of
from lidar_core.circles.estimators.windows import normalised, windows_of_rows, windows_of_segments
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments
from lidar_core.errors import ConfigError, FormatError, InputError

Kind: TypeAlias = Literal["windows", "scans"]

_SMALLEST_RADIUS = 1e-3
_SAME_RAY = 0.1  # of the step between rays: bearings of messages are float32
_ROUNDING = 1e-6  # of range limits, which are float32 in messages [m]
_LEARNT = ("range_low", "range_high", "variance_x", "variance_y", "variance_radius")
_SHAPES: dict[Kind, tuple[dict[str, tuple[int | None, ...]], int]] = {
    "windows": ({"slots": (None, 32, 4), "context": (None, 21)}, 9),
    "scans": ({"scans": (None, 1, None)}, 3),
}


class CircleNetwork:
    """Network that estimates any number of circles in one call.

    Parameters
    ----------
    model : str or Path
        Name of a model of the package, or an ONNX file that `lidar-core export` wrote. If there is
        a card beside it, the file must be the one that the card describes.
    allow_untrusted : bool
        Run a file that is neither shipped nor exported by this user. A model is a program.
    threads : int
        Number of threads of onnxruntime, >= 1.

    Raises
    ------
    ConfigError
        There is no such model, it is not trusted, or `threads` is not >= 1.
    FormatError
        The file is not an ONNX model, does not match its card, or has other inputs and outputs than
        a circle detector; or it has control flow, foreign operators or weights in other files,
        which are always refused.
    LimitError
        The file is larger than 256 MiB.

    Notes
    -----
    Networks on windows estimate a covariance. The paper's network, which takes whole scans, does
    not: all its circles have the variances of its errors on its test data; the paper states none.
    """

    def __init__(
        self, model: str | Path, *, threads: int = 1, allow_untrusted: bool = False
    ) -> None:
        self.path, content, self.card = checked_model(model)
        check_trusted(self.path, content, allow_untrusted=allow_untrusted)
        self._session = _session(self.path, content, threads)
        try:
            metadata = self._session.get_modelmeta().custom_metadata_map
            self.kind = _kind_of(self.path, self._session, metadata)
        except UnicodeDecodeError as error:  # onnxruntime decodes names when it is asked for them
            raise FormatError(f"{self.path}: a name in the model is not UTF-8: {error}") from error
        if self.kind == "scans":
            self._scanner, self._limits, self._variance = _trained_on(self.path, metadata)
            beams = self._session.get_inputs()[0].shape[2]
            if beams != self._scanner.n_beams:
                raise FormatError(
                    f"{self.path}: takes {beams} rays, but was trained on {self._scanner.n_beams}"
                )

    def check_scanner(self, scanner: Scanner, place: str) -> None:
        """Refuse a scanner that a network on whole scans was not trained for.

        Networks on windows are for any scanner.

        Parameters
        ----------
        scanner : Scanner
            Scanner that measures the scans.
        place : str
            Name of the scanner in the configuration; error messages start with it.

        Raises
        ------
        ConfigError
            Rays or range limits of the scanner differ from those of the network.
        """
        if self.kind != "scans" or _is_like(scanner, self._scanner):
            return
        name = self.path.stem if self.path.parent == MODELS else self.path.name
        raise ConfigError(
            f"{place}: the network {name} was trained for {_scanner_text(self._scanner)}, got"
            f" {_scanner_text(scanner)}; use a fit, which works with any scanner, such as"
            " set detector=taubin, or train the network for this scanner"
            " (lidar-core train circles)"
        )

    def _check_bearings(self, bearings: NDArray[np.float64]) -> None:
        """Refuse rays whose spacing differs from that of the scanner of the training."""
        step = self._scanner.angle_increment
        steps = np.diff(bearings)
        if len(steps) and np.abs(steps - step).max() > _SAME_RAY * abs(step):
            told = np.unique(np.degrees(steps).round(3))
            got = f"{told[0]:g}" if len(told) == 1 else f"{told[0]:g} to {told[-1]:g}"
            raise InputError(
                f"bearings: {self.path.name} was trained for {_scanner_text(self._scanner)}, a"
                f" step of {np.degrees(step):g} deg; got steps of {got} deg; use a fit, such as"
                ' detector "ml", or a network trained for this scanner'
            )

    def of_rows(
        self,
        ranges: NDArray[np.float32],
        bearings: NDArray[np.float64],
        *,
        config: FitConfig,
        scanner: Scanner,
    ) -> Circles:
        """Estimate one circle per scan (B, n_beams); NaN, with 0 hits, for a scan without hits."""
        hits = np.isfinite(ranges)
        seen = np.flatnonzero(hits.any(axis=1))
        parameters = np.full((len(ranges), 3), np.nan)
        covariance = np.full((len(ranges), 3, 3), np.nan)
        counts = hits.sum(axis=1, dtype=np.int64)
        if len(seen) and self.kind == "scans":
            self._check_bearings(bearings)
            scan, ray = np.nonzero(hits[seen])
            parameters[seen] = self._of_hits(
                ranges[seen[scan], ray], bearings[ray], scan, len(seen)
            )
            covariance[seen] = self._usual(len(seen))
        elif len(seen):
            noise = (config.range_std, config.beam_half_width)
            shown = windows_of_rows(ranges[seen], bearings, scanner=scanner, noise=noise)
            parameters[seen], covariance[seen] = self._of_windows(*shown)
        return Circles(parameters, covariance, counts)

    def of_segments(
        self,
        ranges: NDArray[np.float64],
        bearings: NDArray[np.float64],
        segments: Segments,
        *,
        config: FitConfig,
        scanner: Scanner,
    ) -> Circles:
        """Estimate one circle per segment of a scan, in one call of the network.

        `config` has the noise of the ranges and the width of the rays.
        """
        counts = np.diff(segments.starts)
        if not len(segments):
            return Circles(np.zeros((0, 3)), np.zeros((0, 3, 3)), counts)
        if self.kind == "scans":
            owner = np.repeat(np.arange(len(segments)), counts)
            rays = segments.rays
            parameters = self._of_hits(ranges[rays], bearings[rays], owner, len(segments))
            return Circles(parameters, self._usual(len(segments)), counts)
        noise = (config.range_std, config.beam_half_width)
        shown = windows_of_segments(ranges, bearings, segments, scanner=scanner, noise=noise)
        return Circles(*self._of_windows(*shown), counts)

    def _usual(self, count: int) -> NDArray[np.float64]:
        return np.tile(np.diag(self._variance), (count, 1, 1))

    def _of_windows(
        self, slots: NDArray[np.float32], context: NDArray[np.float32], frames: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        (answers,) = self._session.run(None, {"slots": slots, "context": context})
        return _core.circles_from_answers(frames, answers)

    def _of_hits(
        self,
        ranges: NDArray[np.floating[Any]],
        bearings: NDArray[np.float64],
        owner: NDArray[np.integer[Any]],
        count: int,
    ) -> NDArray[np.float64]:
        """Estimate circles with a network on whole scans, with every hit on its nearest ray."""
        known = self._scanner
        turn = 2 * np.pi / abs(known.angle_increment)
        ray = (bearings - known.angle_min) / known.angle_increment
        beam = np.rint(ray - np.floor((ray + 0.5) / turn) * turn).astype(np.int64)
        inside = (beam >= 0) & (beam < known.n_beams)
        if np.bincount(owner[inside], minlength=count).min(initial=1) == 0:
            raise InputError(
                f"bearings: {self.path.name} covers {np.degrees(known.field_of_view):.0f} degrees"
                f" from {np.degrees(known.angle_min):.0f} on; an object lies outside"
            )
        scans = np.full((count, known.n_beams), np.inf, np.float32)
        place = owner[inside], beam[inside]
        np.minimum.at(scans, place, ranges[inside].astype(np.float32))
        (answers,) = self._session.run(None, {"scans": normalised(scans, *self._limits)})
        parameters = np.asarray(answers, dtype=np.float64)
        parameters[:, 2] = np.maximum(parameters[:, 2], _SMALLEST_RADIUS)
        return parameters


def checked_model(model: str | Path) -> tuple[Path, bytes, dict[str, Any]]:
    """Return file, content and card of a model whose graph uses only arithmetic; do not run it.

    Raises
    ------
    ConfigError
        There is no such model.
    FormatError
        The file is not an ONNX model, does not match its card, or uses other operators.
    LimitError
        The file is too large.
    """
    path = _file_of(model)
    content = content_of(path)
    card = _card_of(path, content)
    check_graph(path, content)
    return path, content, card


def _is_like(scanner: Scanner, known: Scanner) -> bool:
    """Return whether `scanner` has the rays of `known`, and ranges within its limits."""
    rays = (scanner.n_beams, known.n_beams)
    if rays[0] != rays[1]:
        return False
    apart = np.abs(scanner.bearings() - known.bearings()).max()
    return bool(
        apart < _SAME_RAY * abs(known.angle_increment)
        and scanner.range_min >= known.range_min - _ROUNDING
        and scanner.range_max <= known.range_max + _ROUNDING
    )


def _scanner_text(scanner: Scanner) -> str:
    """Describe rays and range limits of a scanner as text, for a comparison by the user."""
    first, last = np.degrees(scanner.bearings()[[0, -1]])
    return (
        f"{scanner.n_beams} rays from {first:.1f} to {last:.1f} deg with ranges from"
        f" {scanner.range_min:g} to {scanner.range_max:g} m"
    )


def _file_of(model: str | Path) -> Path:
    if Path(model).suffix == ".onnx":
        return Path(model)
    path = MODELS / f"{model}.onnx"
    if not path.is_file():
        known = ", ".join(shipped()) or "none"
        raise ConfigError(
            f"detector: expected a shipped model ({known}) or an .onnx file, got {str(model)!r}"
        )
    return path


def _card_of(path: Path, content: bytes) -> dict[str, Any]:
    """Return the card beside a model, whose checksum must be the file's; empty if there is none."""
    card_path = path.with_suffix(".json")
    if not card_path.is_file():
        if path.parent == MODELS:
            raise FormatError(f"{card_path}: the model card is missing; install lidar_core again")
        return {}
    try:
        card = dict(json.loads(card_path.read_text(encoding="utf-8")))
        expected = card["sha256"]
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{card_path}: expected a model card (JSON): {error!r}") from error
    if (got := sha256(content).hexdigest()) != expected:
        raise FormatError(f"{path}: expected SHA-256 {expected} of its model card, got {got}")
    return card


def _session(path: Path, content: bytes, threads: int) -> Any:
    if not isinstance(threads, int) or isinstance(threads, bool) or threads < 1:
        raise ConfigError(f"threads: expected a whole number >= 1, got {threads!r}")
    onnxruntime = import_module("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # The checks read ONNX; a file may also look like onnxruntime's own format.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common class of its own
        raise FormatError(f"{path}: expected an ONNX model: {error}") from error


def _kind_of(path: Path, session: Any, metadata: dict[str, str]) -> Kind:
    """Return the kind of input of a model, and check that its inputs and output fit it."""
    inputs = {one.name: tuple(one.shape) for one in session.get_inputs()}
    outputs = [tuple(one.shape) for one in session.get_outputs()]
    for kind, (expected, size) in _SHAPES.items():
        fits = inputs.keys() == expected.keys() and all(
            len(inputs[name]) == len(shape)
            and all(want in (None, got) for want, got in zip(shape, inputs[name], strict=True))
            for name, shape in expected.items()
        )
        if fits and len(outputs) == 1 and outputs[0][1:] == (size,):
            if metadata.get("kind") != kind:
                raise FormatError(f"{path}: expected metadata kind = {kind}")
            return kind
    raise FormatError(
        f"{path}: expected inputs slots (N, 32, 4) and context (N, 21) with output (N, 9), or"
        f" scans (N, 1, n_beams) with output (N, 3); got {inputs} with {outputs}"
    )


def _trained_on(
    path: Path, metadata: dict[str, str]
) -> tuple[Scanner, tuple[float, float], tuple[float, ...]]:
    """Return scanner, ends of the normalisation and variances of a network on whole scans."""
    try:
        scanner = Scanner.load(
            {name: literal_eval(metadata[name]) for name in Scanner.model_fields}
        )
        low, high, *variance = (float(metadata[name]) for name in _LEARNT)
    except (KeyError, ValueError, SyntaxError) as error:
        raise FormatError(f"{path}: expected scanner and normalisation in its metadata") from error
    return scanner, (low, high), tuple(variance)
