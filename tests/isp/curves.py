"""Response curves and files of them for tests, in the layouts of DoRF and EMoR; the numbers are made here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.isp.response import ResponseCurve

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

GRID = np.linspace(0, 1, 1024)


def family() -> list[ResponseCurve]:
    """Gammas, logarithms and gammas with a shoulder: what cameras' curves look like."""
    curves = [(f"gamma {exponent:.1f}", GRID ** (1 / exponent)) for exponent in np.linspace(1.2, 2.8, 9)]
    curves += [(f"log {base}", np.log1p(base * GRID) / np.log1p(base)) for base in (3, 10, 30, 100)]
    encoded = GRID ** (1 / 2.2)
    shoulder = encoded**2 * (3 - 2 * encoded)
    curves += [(f"shoulder {share}", (1 - share) * encoded + share * shoulder) for share in (0.3, 0.6, 0.9)]
    return [ResponseCurve(GRID, brightness, name) for name, brightness in curves]


def four_a_line(values: NDArray[np.float64]) -> list[str]:
    """EMoR's lines: four numbers each."""
    return [" ".join(f"{value:.9e}" for value in row) for row in values.reshape(-1, 4)]


def write_emor(path: Path, labels: tuple[str, str, str], *sections: NDArray[np.float64]) -> None:
    """Write grid, mean and components as emor.txt or invemor.txt has them."""
    grid, mean, component = labels
    names = [f"{grid} =", f"{mean} =", *(f"{component}({n})=" for n in range(1, len(sections) - 1))]
    lines = [line for name, values in zip(names, sections, strict=True) for line in (name, *four_a_line(values))]
    path.write_text("\n".join(lines) + "\n")


def write_dorf(path: Path, curves: list[ResponseCurve]) -> None:
    """Write curves as dorfCurves.txt has them: six lines each."""
    lines = []
    for curve in curves:
        for label, values in (("I", curve.irradiance[0]), ("B", curve.brightness[0])):
            if label == "I":
                lines += [curve.name, "graph"]
            lines += [f"{label} = ", " ".join(f"{value:.9f}" for value in values)]
    path.write_text("\n".join(lines) + "\n")
