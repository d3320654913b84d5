"""Configuration of what is known about poses beforehand."""

from typing import Annotated, Literal, Self

from pydantic import Field

from lidar_core.config import Config

_Std = Annotated[float, Field(ge=0, le=100)]


class PoseConfig(Config):
    """How certain poses are, and what follows for the map. Source: Vrba et al., sec. IV."""

    position_std: tuple[_Std, _Std, _Std] = Field(
        (0.0, 0.0, 0.0),
        description="Standard deviations along x, y, z of poses that come without a covariance"
        " [m].",
    )
    angle_std: tuple[_Std, _Std, _Std] = Field(
        (0.0, 0.0, 0.0),
        description="The same of the angles about x, y, z of R = Rz Ry Rx [rad]; if all six are 0,"
        " poses are taken for certain.",
    )
    weighting: Literal["off", "ends", "spread"] = Field(
        "ends",
        description="Where poses are uncertain, rays that hit something end earlier, for they must"
        " not clear what their ends may lie in (ends); and a point of the background also pulls"
        " every voxel that it may lie in, each by the probability of that (spread); or the map is"
        " updated as if poses were certain (off) (no unit).",
    )
    end_sigmas: float = Field(
        3.0,
        ge=0,
        le=100,
        description="So many standard deviations, along the ray, of position and range rays end"
        " earlier, unless `weighting` is off or the pose is certain (count, no unit).",
    )

    @classmethod
    def paper(cls) -> Self:
        """The map is updated as if poses were certain."""
        return cls(weighting="off")
