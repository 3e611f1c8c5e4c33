"""A folder of clean raw files to a tree of noisy ones, with a manifest: synthetic pairs on disk.

``OUT/data/<name>/<camera>/scene-<n>/clean.dng`` and ``noisy-<k>.dng`` (or ``.npy``), ``OUT/manifests/<name>.csv`` with
its card, and ``OUT/parameters.json`` with all that the noise was made with. ``<name>`` is OUT's own name.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata.base.files import atomic_write, write_json
from eldata.base.workers import AnyWorkers, Workers, accepts_jobs, require_files
from eldata.datasets.clean import RawFiles
from eldata.errors import ArgumentError, DatasetError, EldataError, RawFileError, check_choice
from eldata.manifest.card import CameraCard, Card
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.noise.components import parse_components
from eldata.noise.model import NoiseModel
from eldata.raw.cfa import cfa_from, pack_normalised, packed_area, packed_black_level_dn, unpack
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import Exposure, FrameRecord, RawFrame

if TYPE_CHECKING:
    from eldata.noise.profile import CameraProfile, RowChoice

Format = Literal["dng", "npy"]


@dataclass(frozen=True, slots=True)
class Recipe:
    """How noisy frames are made.

    Attributes
    ----------
    profile
        The camera whose noise is simulated.
    spec
        The noise model's components. In a DNG, which holds whole DN, real rounding takes the place of U.
    ratio
        (lowest, highest) low-light factor, drawn uniformly in steps of 1/100.
    seed
        First part of each frame's seed: (seed, place of the file, number of the copy).
    iso, row
        As in :meth:`eldata.noise.CameraProfile.sample`.
    per_image
        Noisy frames per clean one.
    format
        ``"dng"``: raw DN; ``"npy"``: packed (C, h, w) float32, normalised and amplified.
    """

    profile: CameraProfile
    spec: str = "P*+G*+B+R+U"
    ratio: tuple[float, float] = (100.0, 300.0)
    seed: int = 0
    iso: float | None = None
    row: RowChoice = "any"
    per_image: int = 1
    format: Format = "dng"

    def __post_init__(self) -> None:
        low, high = self.ratio
        if not 0 < low <= high < 1e6:
            raise ArgumentError(f"ratio must be above 0, the lower first; found {low:g} to {high:g}")
        if self.seed < 0 or self.per_image < 1:
            raise ArgumentError(f"seed must be 0 or more and per_image 1 or more; found {self.seed}, {self.per_image}")
        check_choice("format", self.format, get_args(Format))
        if self.iso is not None:
            self.profile.gain_at_iso(self.iso)  # refuses an ISO that the profile does not know
        self.model()

    def model(self) -> NoiseModel:
        """Return the noise model; for DNG without U, because writing rounds."""
        parts = parse_components(self.spec)
        if self.format == "npy" or not parts.quantisation:
            return NoiseModel(self.spec)
        if parts.spec == "U":
            raise ArgumentError("noise model 'U': writing a DNG rounds to whole DN already; name another component")
        return NoiseModel(replace(parts, quantisation=False).spec)


@accepts_jobs
def synthesize(clean: Path, out: Path, recipe: Recipe, *, workers: AnyWorkers = 1) -> Manifest:
    """Write a noisy tree for a folder of clean raw files; return its manifest.

    Parameters
    ----------
    clean
        Folder, searched through for camera raws; each must state its ISO and exposure time.
    out
        A new or empty folder.
    recipe
        The noise.
    workers
        Number of worker processes, or an executor (:mod:`eldata.base.workers`), whose workers then write below
        ``out``; the files do not depend on it.

    Raises
    ------
    DatasetError
        If ``clean`` holds no raw file, or ``out`` holds something.
    RawFileError
        If a clean file cannot be read, or states no ISO or exposure time.
    EldataError
        If a file cannot be written.
    """
    workers = Workers.of(workers)
    paths = RawFiles(clean).paths
    name = re.sub(r"[^\w.+-]", "-", out.resolve().name) or "synthetic"
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out}: holds something already; give a new folder")
    try:
        for folder in (out / "manifests", out / "data" / name):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EldataError(f"cannot make {error.filename}: {error.strerror}") from error
    work = partial(_synthesize_file, Path.cwd(), (out / "data" / name).absolute(), recipe)
    made = list(workers.run(work, list(enumerate(paths)), label="synthesizing"))
    records = [record for item in made for record in item.records]
    roles = [record.role for record in records]
    card = Card(
        name=name,
        title=f"Synthetic noise of {recipe.profile.camera} on {len(paths)} clean frames",
        version="1.0",
        folder=name,
        citation="none: made by eldata synthesize",
        licence="that of the clean frames",
        homepage="made by eldata synthesize",
        cfa="bayer" if all(item.bayer for item in made) else "xtrans",
        cameras={recipe.profile.camera: CameraCard(tuple(sorted({item.model for item in made})))},
        counts={role: roles.count(role) for role in sorted(set(roles))},
        sources=(f"noise model {recipe.spec}, profile {recipe.profile.camera}: {recipe.profile.source}",),
    )
    parameters = {
        "model": recipe.spec,
        "written_model": recipe.model().components.spec,
        "profile": asdict(recipe.profile),
        "seed": recipe.seed,
        "ratio": list(recipe.ratio),
        "format": recipe.format,
        "frames": [frame for item in made for frame in item.parameters],
    }
    write_json(out / "parameters.json", parameters, indent=1)
    return save_manifest(out / "manifests" / f"{name}.csv", card, records)


@dataclass(frozen=True, slots=True)
class _Made:
    records: tuple[FrameRecord, ...]
    parameters: tuple[dict[str, Any], ...]
    model: str
    bayer: bool


def _synthesize_file(start: Path, folder: Path, recipe: Recipe, unit: tuple[int, Path]) -> _Made:
    index, path = unit
    require_files(start / path)
    frame = _cropped(read_raw(start / path))
    iso, exposure_s = frame.exposure.iso, frame.exposure.exposure_s
    if iso is None or exposure_s is None:
        raise RawFileError(
            path, f"states no {'ISO' if iso is None else 'exposure time'}, which the noisy frame's follows"
        )
    sensor, profile = frame.sensor, recipe.profile
    scene = f"scene-{index + 1}"
    place = folder / profile.camera / scene
    place.mkdir(parents=True, exist_ok=True)
    write_dng(place / "clean.dng", frame.mosaic, sensor, frame.exposure, compression="lossless-jpeg")
    base = f"{profile.camera}/{scene}"
    record = partial(FrameRecord, camera=profile.camera, scene=scene, width=sensor.width, height=sensor.height)
    reference = record(path=f"{base}/clean.dng", role="reference", iso=iso, exposure_s=exposure_s)
    clean = pack_normalised(frame.mosaic, sensor.cfa, sensor.black_level_dn, sensor.white_level_dn)
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn).astype(np.float64)[:, None, None]
    range_dn = sensor.white_level_dn - float(black.mean())
    records, drawn = [reference], []
    for copy in range(recipe.per_image):
        generator = np.random.default_rng([recipe.seed, index, copy])
        parameters = profile.sample(generator, iso=recipe.iso, row=recipe.row)
        low, high = recipe.ratio
        ratio = Fraction(round(float(generator.uniform(low, high)) * 100), 100)
        noisy = recipe.model()(clean, parameters=parameters, ratio=float(ratio), range_dn=range_dn, generator=generator)
        noisy_iso = _iso_of(profile, parameters.gain_dn_per_e, iso)
        noisy_s = (iso * exposure_s / (noisy_iso * ratio)).limit_denominator(2**31)
        name = f"noisy-{copy + 1}.{recipe.format}"
        if recipe.format == "dng":
            dn = noisy.astype(np.float64) * (range_dn / float(ratio)) + black
            mosaic = unpack(np.clip(np.rint(dn), 0, sensor.white_level_dn).astype(np.uint16), sensor.cfa)
            exposure = Exposure(noisy_iso, noisy_s, frame.exposure.f_number)
            write_dng(place / name, mosaic, sensor, exposure, compression="lossless-jpeg")
        else:
            with atomic_write(place / name) as file:
                np.save(file, noisy, allow_pickle=False)
        of_copy = record(path=f"{base}/{name}", role="noisy", iso=noisy_iso, exposure_s=noisy_s)
        records.append(replace(of_copy, ratio=ratio, reference=reference.path))
        drawn.append({"path": f"{base}/{name}", "clean": str(path), "ratio": float(ratio)} | asdict(parameters))
    return _Made(tuple(records), tuple(drawn), sensor.model, len(sensor.cfa) == 2)


def _cropped(frame: RawFrame) -> RawFrame:
    """Return the part of a frame that packs, so that every pixel of the noisy one has its noise."""
    cfa = frame.sensor.cfa
    area = packed_area((frame.mosaic.shape[0], frame.mosaic.shape[1]), cfa)
    sensor = replace(frame.sensor, cfa=cfa_from(cfa, area.top, area.left), height=area.height, width=area.width)
    return replace(frame, mosaic=np.ascontiguousarray(frame.mosaic[area.slices]), sensor=sensor)


def _iso_of(profile: CameraProfile, gain_dn_per_e: float, otherwise: Fraction) -> Fraction:
    """Return the whole ISO that belongs to a gain, if the profile says how they go together."""
    if profile.iso_range is None:
        return otherwise
    return Fraction(max(1, round(profile.iso_range[0] * gain_dn_per_e / profile.gain_range_dn_per_e[0])))
