from __future__ import annotations

import pytest

from eldata.noise.profile import CameraProfile
from eldata.reports.diagnostics import Diagnostics, diagnose, sample_parameters


@pytest.fixture(scope="session")
def sony() -> CameraProfile:
    return CameraProfile.load("SonyA7S2")


@pytest.fixture(scope="session")
def diagnostics(sony: CameraProfile) -> Diagnostics:
    return diagnose(sony, sample_parameters(sony, 0))
