from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.calibration.acceptance.theory import diagnose, sample_parameters
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from eldata.calibration.acceptance.verdicts import Diagnostics


@pytest.fixture(scope="session")
def sony() -> CameraProfile:
    return CameraProfile.load("SonyA7S2")


@pytest.fixture(scope="session")
def diagnostics(sony: CameraProfile) -> Diagnostics:
    return diagnose(sony, sample_parameters(sony, 0))
