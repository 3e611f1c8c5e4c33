"""Response curves for tests: what cameras' curves look like."""

from __future__ import annotations

import numpy as np

from eldata.isp.response import ResponseCurve

GRID = np.linspace(0, 1, 1024)


def family() -> list[ResponseCurve]:
    """Gammas, logarithms and gammas with a shoulder: what cameras' curves look like."""
    curves = [(f"gamma {exponent:.1f}", GRID ** (1 / exponent)) for exponent in np.linspace(1.2, 2.8, 9)]
    curves += [(f"log {base}", np.log1p(base * GRID) / np.log1p(base)) for base in (3, 10, 30, 100)]
    encoded = GRID ** (1 / 2.2)
    shoulder = encoded**2 * (3 - 2 * encoded)
    curves += [(f"shoulder {share}", (1 - share) * encoded + share * shoulder) for share in (0.3, 0.6, 0.9)]
    return [ResponseCurve(GRID, brightness, name) for name, brightness in curves]
