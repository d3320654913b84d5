"""These tests need torch and onnx; where one is missing they do not run, and say so."""

from importlib.util import find_spec

MISSING = [name for name in ("torch", "onnx", "lidar_core_training") if find_spec(name) is None]
collect_ignore_glob = ["test_*.py"] if MISSING else []


def pytest_report_header() -> str:
    """Tell what is missing."""
    return f"training is not tested: {', '.join(MISSING)} not installed" if MISSING else ""
