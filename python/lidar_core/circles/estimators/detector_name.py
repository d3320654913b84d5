"""Names of circle estimators: fits, networks of the package, files."""

from pathlib import Path
from typing import get_args

from lidar_core.circles.estimators.fit_config import FitMethod

MODELS = Path(__file__).parents[1] / "models"


def shipped() -> list[str]:
    """Names of the models that come with the package."""
    return sorted(path.stem for path in MODELS.glob("*.onnx"))


def checked(detector: object) -> object:
    """Return `detector` if it is a fit, a network, or the path of an .onnx file.

    Raises
    ------
    ValueError
        `detector` is none of these; the text states what was expected.
    """
    known = (*get_args(FitMethod), *shipped())
    if isinstance(detector, str | Path) and (
        str(detector) in known or Path(detector).suffix == ".onnx"
    ):
        return detector
    raise ValueError(f"expected one of {', '.join(known)}, or an .onnx file")
