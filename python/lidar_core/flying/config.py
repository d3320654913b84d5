"""Configuration of the flying-object detector: the only source of defaults and ranges.

Longer than other files: every field carries its description, unit, range and source.
"""

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from lidar_core.config import Config
from lidar_core.flying.config_types import MOST_POINTS, MOST_SCANS, Box
from lidar_core.flying.pose_config import PoseConfig
from lidar_core.flying.sensor_config import SensorConfig
from lidar_core.flying.tracker_config import TrackerConfig


class VoxelMapConfig(Config):
    """Occupancy of voxels, exponential filter G(v), which has no unit.

    Source: Vrba et al., eqs 6-12 and 20-22; defaults: Table II.
    """

    # A voxel below 1 cm is smaller than the noise of ranges; one above 5 m holds target and
    # background at once.
    voxel_size: float = Field(default=0.25, ge=0.01, le=5, description="Edge of a voxel, v_s [m].")
    g_occ: float = Field(
        default=0.0, description="G that background points pull a voxel to (no unit)."
    )
    g_unk: float = Field(
        default=-740.0, description="G that unknown and flying points pull a voxel to (no unit)."
    )
    g_free: float = Field(default=-1000.0, description="G that rays pull a voxel to (no unit).")
    initial: float = Field(default=-740.0, description="G of a voxel never observed (no unit).")
    threshold_confident: float = Field(default=-0.1, description="Occupied from here up (no unit).")
    threshold_tentative: float = Field(
        default=-300.0, description="Tentative from here up (no unit)."
    )
    threshold_uncertain: float = Field(
        default=-750.0, description="Uncertain from here up, free below (no unit)."
    )
    extra_thresholds: tuple[float, ...] = Field(
        default=(),
        max_length=16,
        description="Further levels that `state_at` counts, eq. 6 (no unit).",
    )
    max_range: float = Field(
        default=20.0,
        gt=0,
        le=1000,
        description="Rays clear no further than this, d_max of eq. 20 [m];"
        " `classify.max_distance` is at most as large.",
    )
    end_margin: float = Field(
        default=0.0, ge=0, le=10, description="Rays that hit something end this much earlier [m]."
    )
    rays: Literal["all", "one_per_end"] = Field(
        default="all",
        description="Rays that are cast: all, or of those that end in the same voxel the first, as"
        " often as there are others, which is faster and not exact (no unit).",
    )
    skip: Literal["saturated", "none"] = Field(
        default="saturated",
        description="Voxels that rays pass in one step: those in directions and at distances where"
        " each holds exactly `g_free` or is permanent, or none. Maps, detections and tracks are the"
        " same to the bit (no unit).",
    )
    saturation: Literal["settled", "paper"] = Field(
        default="settled",
        description="settled: a value that rays have pulled to within 64 steps of float32 from"
        " `g_free` becomes `g_free`, so that `skip` passes it also where few rays are; paper:"
        " rounding may hold it some steps short for ever (no unit).",
    )
    ray_unit: Literal["edges", "metres", "diagonals"] = Field(
        default="edges",
        description="Length unit of the ray weight of eq. 22: voxel edges, metres (the paper's"
        " text) or voxel diagonals (no unit).",
    )
    ray_gain: float = Field(
        default=1.0, gt=0, le=1000, description="Factor on the ray weight (no unit)."
    )
    bounds: Box | None = Field(
        default=None,
        description="Lower and upper corner of a fixed operating volume [m]; none: no bounds.",
    )
    max_voxels: int = Field(
        default=200_000_000,
        ge=512,
        le=10**12,
        description="Budget of stored voxels, in whole blocks of 512, 4.3 bytes each (count,"
        " no unit). A full map forgets the voxels farthest from the sensor.",
    )

    @model_validator(mode="after")
    def _levels_are_ordered(self) -> Self:
        levels = [
            self.g_free,
            self.threshold_uncertain,
            self.g_unk,
            self.threshold_tentative,
            self.threshold_confident,
            self.g_occ,
        ]
        if levels != sorted(levels):
            raise ValueError(
                "expected g_free <= threshold_uncertain <= g_unk"
                " <= threshold_tentative <= threshold_confident <= g_occ"
            )
        return self


class ClusterConfig(Config):
    """Clusters of points. Source: Vrba et al., eqs 13-15; defaults: Table II."""

    max_distance: float = Field(
        default=0.25, gt=0, le=10, description="Largest gap inside a cluster, d_cluster [m]."
    )
    max_angle: float = Field(
        default=0.02,
        ge=0,
        le=0.5,
        description="Gaps of this angle times the range of the nearer point are inside a cluster"
        " too, three times the angle between the rays of an OS1-128 [rad]; sparser sensors whose"
        " sky is found, and that have no rows, widen it; paper: 0.",
    )
    min_points: int = Field(
        default=1,
        ge=1,
        le=MOST_POINTS,
        description="Smaller clusters are unknown (count, no unit).",
    )
    max_points: int | None = Field(
        default=None,
        ge=1,
        le=MOST_POINTS,
        description="Larger clusters are unknown (count, no unit).",
    )
    of: Literal["points", "voxels"] = Field(
        default="points",
        description="Input of the clustering: points, or the centres of their voxels as in"
        " the authors' code (no unit).",
    )


class ClassifyConfig(Config):
    """Classes of clusters: background, flying, unknown.

    Source: Vrba et al., sec. III-B and Algorithm 1; defaults: Table II, and additions of best mode.
    """

    close_distance: float = Field(
        default=0.7,
        gt=0,
        le=10,
        description="Rule A: a point closer than this to the centre of an occupied voxel is"
        " background, d_close [m].",
    )
    search_distance: float = Field(
        default=3.0,
        gt=0,
        le=100,
        description="Rule B: a path of uncertain voxels this long (L1) connects a cluster,"
        " d_search [m].",
    )
    search_adds_extent: bool = Field(
        default=False,
        description="The diagonal of a cluster's box is added to its search distance, as in the"
        " authors' code (no unit).",
    )
    map_state: Literal["before", "after_update"] = Field(
        default="before",
        description="Rule B reads the map before this scan's update, or after it as in the"
        " authors' code (no unit).",
    )
    border: Literal["open", "closed"] = Field(
        default="open",
        description="Border of a fixed operating volume for a search: a way out (open) or a"
        " wall (closed, the paper) (no unit).",
    )
    shadow: Literal["own", "paper"] = Field(
        default="own",
        description="own: uncertain voxels in a cluster's own shadow do not connect it;"
        " paper: they do, and a target approached head-on is never found (no unit).",
    )
    own_voxels: Literal["expanded", "paper"] = Field(
        default="expanded",
        description="expanded: the search continues from the voxels of the cluster even if they are"
        " free, so that a wall seen at a grazing angle is not detected as flying; paper: it does"
        " not (no unit).",
    )
    max_extent: float | None = Field(
        default=2.5,
        gt=0,
        le=50,
        description="Largest diagonal of the box of a group of clusters that can be a flying"
        " object [m]; the visible side of a sphere has one of up to 3.1 radii.",
    )
    background_extent: float | None = Field(
        default=3.5, gt=0, le=100, description="Larger clusters are background at any time [m]."
    )
    min_points: int = Field(
        default=3,
        ge=1,
        le=MOST_POINTS,
        description="Least number of points of a flying object (count, no unit).",
    )
    max_distance: float | None = Field(
        default=20.0,
        gt=0,
        le=1000,
        description="Largest distance of a flying object from the sensor, at most"
        " `voxel_map.max_range` [m]: nothing can be classified beyond the map.",
    )
    group_distance: float | None = Field(
        default=0.7,
        gt=0,
        le=10,
        description="Clusters with gaps up to this are classified together: by their common extent,"
        " and as background if background of this scan is among them [m]; none: each by itself.",
    )
    min_clearance: float = Field(
        default=0.625,
        ge=0,
        le=1,
        description="A flying object has at least this share of free voxels around its own voxels:"
        " only the neighbours behind it may be hidden (share, no unit).",
    )
    upright_height: float | None = Field(
        default=1.2,
        gt=0,
        le=50,
        description="Clusters at least this high, whose diagonal on the ground is at most two"
        " fifths of their height, count as standing objects such as signs and"
        " people, and do not fly [m].",
    )
    follow_tracks: bool = Field(
        default=True,
        description="Unknown clusters that continue a confirmed track are flying objects, even if"
        " their surroundings are not known (no unit).",
    )
    fill_pockets: bool = Field(
        default=False,
        description="Enclosed uncertain voxels around a flying cluster become free (no unit).",
    )
    search: Literal["explained", "full"] = Field(
        default="explained",
        description="explained: points that rule A makes background anyway are one cluster, and"
        " only the others are searched for clusters; full: all points are searched. Classes,"
        " detections and tracks are the same to the bit; where they may not be (clusters of limited"
        " size or of voxels, `map_state` after_update, voxels larger than `close_distance`), all"
        " are searched (no unit).",
    )

    @classmethod
    def paper(cls) -> Self:
        """Rules A, B and C as published, without gates."""
        return cls(
            border="closed",
            shadow="paper",
            own_voxels="paper",
            max_extent=None,
            background_extent=None,
            min_points=1,
            max_distance=None,
            group_distance=None,
            min_clearance=0.0,
            upright_height=None,
            follow_tracks=False,
        )


class SeparateConfig(Config):
    """Removal of separate background. Source: Vrba et al., sec. III-D, eq. 23."""

    max_gap: float = Field(
        default=0.8,
        ge=0,
        le=10,
        description="Largest distance between the centres of neighbouring voxels of a group,"
        " d_sep; not in Table II, taken from the authors' code [m].",
    )
    min_confident: int = Field(
        default=24,
        ge=0,
        le=10**9,
        description="Groups with fewer confidently occupied voxels are removed, n_conf,min"
        " (count, no unit).",
    )
    dilate: bool = Field(
        default=False,
        description="Observed voxels within `max_gap` of a removed one are pulled towards free"
        " too, as in the authors' code (no unit).",
    )
    waits_for_background: bool = Field(
        default=True,
        description="Nothing is removed before one group holds `min_confident` confident voxels;"
        " otherwise removal begins with the first scan, as in the paper, and pulls down the"
        " background of sparse sensors faster than they build it up (no unit).",
    )


class SeedConfig(Config):
    """Source of the first background, which the paper does not state.

    Without a background, no cluster is classified as flying. Other sources are an a-priori map:
    `FlyingObjectDetector.set_occupied`, `load_map`.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "standing_shift": "points that stand move by 4 cm at most",
        "standing_track_distance": "a track 0.5 m from its start follows nothing that stands",
    }
    burn_in_scans: int = Field(
        default=10,
        ge=0,
        le=MOST_SCANS,
        description="First scans, in which nothing is reported (count, no unit).",
    )
    burn_in_period: float | None = Field(
        default=0.1,
        gt=0,
        le=60,
        description="Time between two scans to which `burn_in_scans` and `standing_scans` refer"
        " [s]. Sensors with another time use as many scans as fit into the same total time, at"
        " least 3. None, as in paper mode: both numbers apply at every scan rate.",
    )
    burn_in_extent: float = Field(
        default=2.5,
        gt=0,
        le=50,
        description="During the burn-in clusters with a larger diagonal of their box are"
        " background; must exceed that of the largest target [m].",
    )
    standing_scans: int = Field(
        default=5,
        ge=0,
        le=MOST_SCANS,
        description="Points that keep their place in this many scans of the burn-in, at least"
        " 3, are background, however few; 0 for none (count, no unit).",
    )
    ground_height: float | None = Field(
        default=None,
        ge=-1e4,
        le=1e4,
        description="Clusters that reach below this height are background, world frame [m].",
    )
    take_off_height: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="Height of the sensor above the ground in the first scan: the ground below"
        " is occupied [m].",
    )


class FlyingConfig(Config):
    """The flying-object detector: `FlyingConfig()` is best mode, `.paper()` the paper, Table II."""

    removed: ClassVar[Mapping[str, str]] = {
        "target_radius": "the smallest target has a radius of 0.325 m",
    }
    voxel_map: VoxelMapConfig = VoxelMapConfig()
    cluster: ClusterConfig = ClusterConfig()
    classify: ClassifyConfig = ClassifyConfig()
    separate: SeparateConfig = SeparateConfig()
    seed: SeedConfig = SeedConfig()
    sensor: SensorConfig = Field(
        default=SensorConfig(), description="LiDARs that `sensors` does not name (no unit)."
    )
    sensors: dict[str, SensorConfig] = Field(
        default={}, description="LiDARs by the name that `process` is given (no unit)."
    )
    tracker: TrackerConfig = TrackerConfig()
    pose: PoseConfig = PoseConfig()
    range_margin: float = Field(
        default=2.0,
        ge=0,
        le=100,
        description="Rays clear this much further than `voxel_map.max_range`, so that the space"
        " around a target at that range is observed [m].",
    )
    position: Literal["center", "paper"] = Field(
        default="center",
        description="Position of a detection: the centre of the target behind the points that were"
        " hit, or the centroid of these points, eq. 19 (no unit).",
    )
    range_std: float = Field(
        default=0.03,
        ge=0,
        le=1,
        description="Standard deviation of a range, for detection covariances [m].",
    )
    mismatch_share: float | None = Field(
        default=0.5,
        gt=0,
        le=1,
        description="A scan with a larger share of returns in free space does not change the map"
        " (share, no unit); none: every scan does.",
    )
    forget_distance: float | None = Field(
        default=None,
        gt=0,
        le=1e5,
        description="The map forgets blocks that are further from the sensor [m].",
    )
    few_returns_distance: float | None = Field(
        default=100.0,
        gt=0,
        le=1000,
        description="Largest distance in which targets are tracked before a scan detects them:"
        " those of one or two returns per scan, and those beyond `classify.max_distance` [m]; none:"
        " no target is.",
    )
    on_bad_scan: Literal["raise", "count"] = Field(
        default="raise", description="Reaction to a scan that cannot be used (no unit)."
    )

    @field_validator("sensors")
    @classmethod
    def _names_can_be_printed(cls, sensors: dict[str, SensorConfig]) -> dict[str, SensorConfig]:
        for name in sensors:
            if not name.isprintable():
                raise ValueError(f"expected names that can be printed, got {name!a}")
        return sensors

    @model_validator(mode="after")
    def _targets_are_within_the_map(self) -> Self:
        # Another map is meant: targets are then found as far as it reaches.
        distance, reach = self.classify.max_distance, self.voxel_map.max_range
        is_usual_map = reach == VoxelMapConfig.model_fields["max_range"].default
        if distance is not None and distance > reach and is_usual_map:
            raise ValueError(
                f"expected classify.max_distance <= voxel_map.max_range, got {distance:g} and"
                f" {reach:g} m: no ray clears the space beyond the map, so nothing is found there;"
                f" set voxel_map.max_range={distance:g} or classify.max_distance={reach:g}"
            )
        return self

    @classmethod
    def long_range(cls) -> Self:
        """Best mode with d_max 50 m: for dense LiDARs; the map costs more time and memory."""
        return cls(
            voxel_map=VoxelMapConfig(max_range=50.0), classify=ClassifyConfig(max_distance=50.0)
        )

    @classmethod
    def paper(cls) -> Self:
        """The algorithms as published, with the parameters of Table II.

        No return is dropped by its range. The paper does not specify the burn-in that seeds the
        background, which gets an extent for targets of the paper's size, and d_sep, which keeps its
        default. Removal of separate background begins once there is a background.
        """
        return cls(
            voxel_map=VoxelMapConfig(ray_unit="metres", saturation="paper"),
            cluster=ClusterConfig(max_angle=0.0),
            classify=ClassifyConfig.paper(),
            seed=SeedConfig(burn_in_period=None, burn_in_extent=1.0, standing_scans=0),
            sensor=SensorConfig.paper(),
            tracker=TrackerConfig.paper(),
            position="paper",
            pose=PoseConfig.paper(),
            range_margin=0.0,
            mismatch_share=None,
            few_returns_distance=None,
        )
