from __future__ import annotations

import os
import shutil
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


@pytest.fixture(scope="session")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        if os.environ.get("ELDATA_REQUIRE_BROWSER"):
            pytest.fail("ELDATA_REQUIRE_BROWSER is set and there is no chromium")
        pytest.skip("no chromium here; apt-get install chromium")
    return found
