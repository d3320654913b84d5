"""Settings and fixtures shared by all tests."""

import os

from hypothesis import HealthCheck, settings

# The same examples on every run; `HYPOTHESIS_PROFILE=wide` looks further.
settings.register_profile(
    "ci",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("wide", settings.get_profile("ci"), derandomize=False, max_examples=5000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))
