"""The file of a dark shading: what it holds comes back; what is damaged or hostile is refused before it is loaded."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.errors import ArgumentError, ShadingError
from eldata.noise import DarkShading, ShadingIso

CFA = ((1, 0), (2, 3))
SHAPE = (12, 16)
LEVELS = (1.5, -0.25, 3.0, 0.5)


def iso_of(iso: float, mode: int) -> ShadingIso:
    return ShadingIso(iso=iso, mode=mode, frames=10, sigma_dn=2.5, level_error_dn=LEVELS, standard_error_dn=(0.1,) * 4)


@pytest.fixture
def shading() -> DarkShading:
    generator = np.random.default_rng(0)
    slope, offset = generator.normal(0, 1e-3, (2, *SHAPE)), generator.normal(0, 2, (2, *SHAPE))
    return DarkShading(
        camera="Demo",
        source="a test",
        cfa=CFA,
        isos=(iso_of(100, 0), iso_of(1600, 0), iso_of(3200, 1)),
        slope_dn=slope.astype(np.float32),
        offset_dn=offset.astype(np.float32),
        hot=generator.random(SHAPE) < 0.1,
        notes=("ISO 800 was left out: light",),
    )


def test_a_shading_is_line_and_level_at_any_part(shading: DarkShading) -> None:
    whole = shading.at(1600)
    expected = shading.slope_dn[0] * 1600.0 + shading.offset_dn[0]
    expected = expected + np.tile(np.array(LEVELS)[np.array(CFA)], (6, 8))
    np.testing.assert_allclose(whole, expected, atol=1e-5)
    assert whole.dtype == np.float32
    for rows, columns in ((slice(3, 8), slice(5, 16)), (slice(2, 4), slice(1, 2))):  # out of step with the CFA, too
        assert np.array_equal(shading.at(1600, rows, columns), whole[rows, columns])
    assert not np.array_equal(shading.at(3200), shading.at(1600))
    with pytest.raises(ArgumentError, match=r"not measured at ISO 800.*there are 100, 1600, 3200"):
        shading.at(800)


def test_a_file_comes_back(shading: DarkShading, tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    shading.save(path)
    found = DarkShading.load(path)
    assert found.summary() == shading.summary()
    assert (found.camera, found.source, found.cfa, found.digest) == ("Demo", "a test", CFA, shading.digest)
    for name in ("slope_dn", "offset_dn", "hot"):
        assert np.array_equal(getattr(found, name), getattr(shading, name))
    shading.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()
    with np.load(path) as archive:  # numpy alone reads it
        assert sorted(archive) == ["about", "hot", "offset_dn", "slope_dn"]


def test_the_digest_is_what_it_was(shading: DarkShading) -> None:
    """Digests stand in results and protocols."""
    assert shading.digest == "sha256:9d12d7857ed3931c6a67544a71abdcd11254a761f2e6f54ad6a8884b69514ab1"
    other = replace(shading, model="Maker 1").digest
    assert other == "sha256:f63d44fb312aa25ebc2aa98d2342f4fd80cff67981595462f536cba4f9f82b2b"


def test_what_does_not_go_together_is_refused(shading: DarkShading) -> None:
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"isos": ()}, "one ISO or more"),
        ({"isos": shading.isos[::-1]}, "ascending"),
        ({"isos": (iso_of(100, 0), iso_of(1600, 0))}, "2 gain modes are numbered"),
        ({"isos": (replace(iso_of(100, 0), level_error_dn=(0.0,)), iso_of(200, 1))}, "ISO 100: expected 4 levels"),
        ({"hot": shading.hot[1:]}, "slope_dn is float32"),
        ({"slope_dn": shading.slope_dn.astype(np.float64)}, "slope_dn is float32"),
        ({"offset_dn": np.full((2, *SHAPE), np.nan, np.float32)}, "offset_dn holds values that are not finite"),
    )
    for change, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            replace(shading, **change)


def refused(path: Path) -> str:
    with pytest.raises(ShadingError) as caught:
        DarkShading.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewritten(path: Path, fields: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write a file again with other fields or arrays, whose digest is not looked at before them."""
    with np.load(path) as archive:
        held = dict(archive)
    data = json.loads(held["about"].tobytes()) | fields
    held["about"] = np.frombuffer(json.dumps(data).encode(), np.uint8)
    with path.open("wb") as file:
        np.savez(file, **(held | arrays))


def test_other_and_damaged_files_are_refused(shading: DarkShading, tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    assert "cannot be read: No such file" in refused(path)
    path.write_bytes(b"PK\x03\x04 and nothing else")
    assert "(is not a whole npz archive); write it again with eldata calibrate --dark-shading" in refused(path)
    np.savez(path, prediction=np.zeros(3))
    assert "about: expected up to 1048576 bytes" in refused(path)
    shading.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-200])
    refused(path)
    at = whole.index(shading.slope_dn.tobytes()) + 9
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    assert "CRC" in refused(path)

    cases: tuple[tuple[dict[str, Any], dict[str, NDArray[Any]], str], ...] = (
        ({"schema": 4}, {}, "field schema: expected 1 or 2 (a newer"),
        ({"schema": 2}, {}, "field model: expected a text"),
        ({"colour": 1}, {}, "field colour: is unknown"),
        ({"camera": "Other"}, {}, "field digest: expected sha256:"),
        ({"cfa": []}, {}, "write it again"),
        ({"height": 40_000, "width": 40_000}, {}, "the file is too small for 2 x 40000 x 40000 pixels"),
        ({"height": 6}, {}, r"slope_dn: expected float32 (2, 6, 16), found float32 (2, 12, 16)"),
        ({}, {"hot": np.zeros(SHAPE, np.uint8)}, "hot: expected bool"),
        ({}, {"about": np.zeros(2 << 20, np.uint8)}, "about: expected up to 1048576 bytes"),
    )
    for fields, arrays, words in cases:
        path.write_bytes(whole)
        rewritten(path, fields, arrays)
        assert words in refused(path)
