"""Configuration of the certainty of poses."""

from typing import Annotated, Literal, Self

from pydantic import Field

from lidar_core.config import Config

_Std = Annotated[float, Field(ge=0, le=100)]
_Angle = Annotated[float, Field(ge=0, le=3.2)]


class PoseConfig(Config):
    """Certainty of poses, and its effect on the map. Source: Vrba et al., sec. IV."""

    position_std: tuple[_Std, _Std, _Std] = Field(
        default=(0.0, 0.0, 0.0),
        description="Standard deviations along x, y, z of poses that come without a covariance"
        " [m].",
    )
    angle_std: tuple[_Angle, _Angle, _Angle] = Field(
        default=(0.0, 0.0, 0.0),
        description="Standard deviations of the angles about x, y, z of R = Rz Ry Rx [rad]; if all"
        " six standard deviations are 0, poses are exact.",
    )
    weighting: Literal["off", "ends", "spread"] = Field(
        default="ends",
        description="Effect of uncertain poses. ends: rays with a return end earlier, because they"
        " must not clear the voxels that may contain their ends; spread: in addition, a point of"
        " the background updates every voxel that may contain it, weighted by the probability;"
        " off: the map is updated as if poses were exact (no unit).",
    )
    end_sigmas: float = Field(
        default=3.0,
        ge=0,
        le=100,
        description="Rays end earlier by this many standard deviations of position and range"
        " along the ray, unless `weighting` is off or the pose is certain (count,"
        " no unit).",
    )

    @classmethod
    def paper(cls) -> Self:
        """Return the paper's variant: the map is updated with poses that count as certain."""
        return cls(weighting="off")
