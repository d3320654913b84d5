"""Settings and fixtures shared by all tests."""

import os
from fnmatch import fnmatchcase
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from repository import RECORDINGS, ROOT

# Of numpy, which is imported later, and of child processes. The workers of pytest share the cores,
# and threads that wait for one another there take processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The same examples on every run; `make nightly` looks at 200, `HYPOTHESIS_PROFILE=wide` at 5,000.
settings.register_profile(
    "ci",
    derandomize=True,
    max_examples=25,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("nightly", settings.get_profile("ci"), max_examples=200)
settings.register_profile("wide", settings.get_profile("ci"), derandomize=False, max_examples=5000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test with the marker `ci_cases`, the cases that no pattern names are nightly."""
    met: dict[tuple[str, str], bool] = {}
    for item in items:
        marker = item.get_closest_marker("ci_cases")
        if marker is None:
            continue
        case = getattr(item, "callspec", None)
        name, found = item.nodeid.partition("[")[0], False
        for pattern in marker.args:
            fits = case is not None and fnmatchcase(case.id, pattern)
            met[name, pattern] = met.get((name, pattern), False) or fits
            found = found or fits
        if not found:
            item.add_marker(pytest.mark.nightly)
    whole = config.args_source == pytest.Config.ArgsSource.TESTPATHS
    if whole and not all(met.values()):
        wrong = [f"{name}: {pattern!r}" for (name, pattern), fits in met.items() if not fits]
        raise pytest.UsageError(f"ci_cases names cases that do not exist: {'; '.join(wrong)}")


def _present(path: Path, what: str) -> Path:
    """`path`, if it exists; else a failure in CI and a skip elsewhere."""
    if not path.exists():
        text = f"{what} not found at {path}"
        if os.environ.get("CI") == "true":
            pytest.fail(text)
        pytest.skip(text)
    return path


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of real recordings."""
    return _present(RECORDINGS, "real recordings")


@pytest.fixture(scope="session")
def ouster_python() -> Path:
    """Interpreter of the environment that holds ouster-sdk."""
    default = ROOT / ".venv-ouster" / "bin" / "python"
    return _present(
        Path(os.environ.get("LIDAR_CORE_OUSTER_PYTHON", default)), "environment with ouster-sdk"
    )
