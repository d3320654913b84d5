"""Datasets of single circles on disk: shards with checksums, made in parts, read in parts."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.circles.dataset_config import DatasetConfig
from lidar_core.circles.samples import SIDES, Samples, joined, make_samples
from lidar_core.errors import ConfigError, FormatError, LidarCoreError
from lidar_core.files import check_regular, read_text
from lidar_core.io.files.atomic import written_whole
from lidar_core.io.files.guard import reading
from lidar_core.io.files.npy import archive_of, array_in

Part: TypeAlias = Literal["train", "validation", "test", "all"]

MANIFEST = "dataset.json"
_FORMAT = 1
MOST_SAMPLES = 2**32
"""Largest number of samples that the manifest of a dataset may state."""
_SHARD = re.compile(r"shard-\d{1,9}\.npz")
_KINDS = {int: "an integer", dict: "a table"}
_WIDTHS = {"circles": (3,), "sides": (2,)}
_DTYPES = {
    "first_ray": np.dtype(np.uint32),
    "n_rays": np.dtype(np.uint32),
    "sides": np.dtype(np.uint8),
}
"""Columns of a shard that are more than one number wide, and those that are no float32."""


@dataclass(frozen=True, slots=True)
class CircleDataset:
    """A dataset in a folder.

    Attributes
    ----------
    folder : Path
        Folder of the dataset.
    config : DatasetConfig
        Configuration that the dataset was made with.
    seed : int
        Seed of circles, noise and split.
    n_samples : int
        Number of samples in all shards, including shards that are not made yet.
    shards : tuple of str
        Existing files, in order.
    """

    folder: Path
    config: DatasetConfig
    seed: int
    n_samples: int
    shards: tuple[str, ...]

    @property
    def is_complete(self) -> bool:
        """True if every shard was made."""
        return len(self.shards) == -(-self.n_samples // self.config.shard_size)

    def numbers(self, part: Part) -> NDArray[np.int64]:
        """Indices of the samples in one part, ascending; Table II."""
        return split(self.config, self.n_samples, part, seed=self.seed)

    def read(self, part: Part = "all") -> Samples:
        """Read all samples of one part into memory.

        Raises
        ------
        FormatError
            The dataset is not complete, or a shard is damaged.
        """
        if not self.is_complete:
            raise FormatError(
                f"{self.folder}: the dataset is incomplete; generate it again to continue"
            )
        numbers = self.numbers(part)
        size = self.config.shard_size
        parts = []
        for index, name in enumerate(self.shards):
            wanted = numbers[(numbers >= index * size) & (numbers < (index + 1) * size)]
            shard = _read_shard(self.folder / name, self.config, size)
            if (expected := min(size, self.n_samples - index * size)) != len(shard):
                raise FormatError(
                    f"{self.folder / name}: expected {expected} samples, got {len(shard)}"
                )
            parts.append(shard.take(wanted - index * size))
        return joined(parts)


def lattice(config: DatasetConfig) -> NDArray[np.float64]:
    """Return the circles of a lattice that the scanner sees, shape (N, 3): x, y, radius [m]."""
    low, high = (round(radius / config.radius_step) for radius in config.radius)
    return _core.circle_lattice(
        config.scanner,
        reach=config.reach,
        spacing=config.spacing,
        radius_steps=(low, high),
        radius_step=config.radius_step,
    )


def split(config: DatasetConfig, n_samples: int, part: Part, *, seed: int) -> NDArray[np.int64]:
    """Return the indices of the samples in one part of a dataset, ascending; Table II."""
    if part == "all":
        return np.arange(n_samples)
    together = config.draws if config.split_by == "circle" else 1
    n_units = n_samples // together
    order = np.random.default_rng(seed).permutation(n_units)
    n_test = round(n_units * config.test_share)
    n_validation = round(n_units * config.validation_share)
    first, last = {
        "test": (0, n_test),
        "validation": (n_test, n_test + n_validation),
        "train": (n_test + n_validation, n_units),
    }[part]
    units = np.sort(order[first:last])
    return (units[:, None] * together + np.arange(together)).reshape(-1)


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    seed: int,
    threads: int = 1,
    on_shard: Callable[[int, int], None] | None = None,
) -> CircleDataset:
    """Make a dataset in a folder, or complete one.

    Parameters
    ----------
    config : DatasetConfig
        Content of the dataset.
    folder : str or Path
        Folder of the dataset; created if missing. Complete shards in it are kept.
    seed : int
        Decides circles, noise and split.
    threads : int
        Number of threads; the result does not depend on it.
    on_shard : callable, optional
        Called after each shard as `on_shard(finished, total)`, with the numbers of finished shards
        and of all shards.

    Returns
    -------
    CircleDataset
        The complete dataset in `folder`.

    Raises
    ------
    ConfigError
        Another dataset is in the folder.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    circles = lattice(config) if config.kind == "lattice" else None
    n_samples = config.circles if circles is None else len(circles) * config.draws
    sums = _known_shards(place, config, seed)
    n_shards = -(-n_samples // config.shard_size)
    for index in range(n_shards):
        name = f"shard-{index:05d}.npz"
        if sums.get(name) is None or _sum(place / name) != sums[name]:
            start = index * config.shard_size
            count = min(config.shard_size, n_samples - start)
            samples = make_samples(
                config, count=count, seed=seed, start=start, circles=circles, threads=threads
            )
            columns = {field.name: getattr(samples, field.name) for field in fields(Samples)}
            with written_whole(place / name) as temporary, temporary.open("wb") as file:
                np.savez(file, **columns)
            sums[name] = _sum(place / name)
            _write_manifest(place, config, seed, n_samples, sums)
        if on_shard is not None:
            on_shard(index + 1, n_shards)
    return open_dataset(place)


def open_dataset(folder: str | Path, *, verify: bool = False) -> CircleDataset:
    """Return the dataset in a folder.

    Parameters
    ----------
    folder : str or Path
        Folder that `generate` made.
    verify : bool
        Compare the checksum of every shard.

    Raises
    ------
    FormatError
        The folder holds no dataset, or a shard is damaged.
    """
    place = Path(folder)
    manifest = _read_manifest(place)
    sums: dict[str, str] = manifest["shards"]
    if verify:
        for name, expected in sums.items():
            if (got := _sum(place / name)) != expected:
                raise FormatError(f"{place / name}: expected SHA-256 {expected}, got {got}")
    config = DatasetConfig.load(manifest["config"])
    return CircleDataset(place, config, manifest["seed"], manifest["samples"], tuple(sorted(sums)))


def _known_shards(folder: Path, config: DatasetConfig, seed: int) -> dict[str, str]:
    """Return checksums of the shards that were made before, by this configuration and seed."""
    if not (folder / MANIFEST).exists():
        return {}
    manifest = _read_manifest(folder)
    if (DatasetConfig.load(manifest["config"]), manifest["seed"]) != (config, seed):
        raise ConfigError(
            f"{folder}: holds a dataset of another configuration or seed; choose another folder"
        )
    return dict(manifest["shards"])


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    try:
        manifest = json.loads(read_text(path))
        known = manifest["format"]
    except FileNotFoundError as error:
        raise FormatError(f"{path}: expected a dataset of circles, got no such file") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FormatError(f"{path}: expected the manifest of a dataset: {error!r}") from error
    if known != _FORMAT:
        raise FormatError(f"{path}: expected format {_FORMAT}, got {known}")
    kinds = {"seed": int, "samples": int, "config": dict, "shards": dict}
    for name, kind in kinds.items():
        if type(manifest.get(name)) is not kind:
            raise FormatError(
                f"{path}: {name}: expected {_KINDS[kind]}, got {manifest.get(name)!r}"
            )
    if manifest["seed"] < 0 or not 0 <= manifest["samples"] <= MOST_SAMPLES:
        raise FormatError(f"{path}: expected a seed >= 0 and 0 to {MOST_SAMPLES} samples")
    for name in manifest["shards"]:
        if not _SHARD.fullmatch(name):  # a path would lead out of the folder
            raise FormatError(
                f"{path}: shards: expected names such as shard-00000.npz, got {name!r}"
            )
    return dict(manifest)


def _write_manifest(
    folder: Path, config: DatasetConfig, seed: int, n_samples: int, sums: dict[str, str]
) -> None:
    manifest = {
        "format": _FORMAT,
        "seed": seed,
        "samples": n_samples,
        "config": config.model_dump(mode="json"),
        "shards": sums,
    }
    with written_whole(folder / MANIFEST) as temporary:
        temporary.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")


def _read_shard(path: Path, config: DatasetConfig, most: int) -> Samples:
    """Read the samples of one file, at most `most`; sizes are checked before any allocation."""
    size = check_regular(path).stat().st_size
    try:
        with reading(str(path)), archive_of(path) as archive:
            samples = Samples(
                *(
                    array_in(archive, field.name, what="column", limit=size, key="nothing")
                    for field in fields(Samples)
                )
            )
    except LidarCoreError as error:
        raise FormatError(f"{path}: expected a shard of a dataset: {error}") from error
    if problem := _problem(samples, config, most):
        raise FormatError(f"{path}: expected a shard of a dataset: {problem}")
    return samples


def _problem(samples: Samples, config: DatasetConfig, most: int) -> str:
    """Return as text what is inconsistent in a shard; empty if nothing is."""
    count = len(samples.circles) if samples.circles.ndim else -1
    for field in fields(Samples):
        array = getattr(samples, field.name)
        shape = (
            array.shape
            if field.name == "ranges" and array.ndim == 1
            else (count, *_WIDTHS.get(field.name, ()))
        )
        dtype = _DTYPES.get(field.name, np.dtype(np.float32))
        if array.shape != shape or array.dtype != dtype:
            return f"{field.name}: expected {dtype} {shape}, got {array.dtype} {array.shape}"
    if count > most:
        return f"expected at most {most} samples, got {count}"
    rays = config.scanner.n_beams
    if (samples.n_rays > rays).any() or (samples.first_ray >= rays).any():
        return f"a window leaves the {rays} rays of the scanner"
    if int(samples.n_rays.sum(dtype=np.int64)) != len(samples.ranges):
        return f"{len(samples.ranges)} ranges, but its windows have another number of rays"
    return "" if (samples.sides < len(SIDES)).all() else "a side that there is not"


def _sum(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
