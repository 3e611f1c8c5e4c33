from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.noise.profile import CameraProfile
from eldata.reports.diagnostics import diagnose, sample_parameters

if TYPE_CHECKING:
    from eldata.reports.comparison import Diagnostics


@pytest.fixture(scope="session")
def sony() -> CameraProfile:
    return CameraProfile.load("SonyA7S2")


@pytest.fixture(scope="session")
def diagnostics(sony: CameraProfile) -> Diagnostics:
    return diagnose(sony, sample_parameters(sony, 0))
