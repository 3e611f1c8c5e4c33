"""A folder of clean raw files to a tree of noisy ones, with a manifest: synthetic pairs on disk.

``OUT/data/<name>/<camera>/scene-<n>/clean.dng`` and ``noisy-<k>.dng`` (or ``.npy``), ``OUT/manifests/<name>.csv`` with
its card, and ``OUT/parameters.json`` with all that the noise was made with. ``<name>`` is OUT's own name. Until all is
written, ``OUT/.begun`` says what was begun. Of clips the m-th frame of the n-th is the scene
``clip-<n>-moment-<m>``, so that the rows are sequences (:mod:`eldata.manifest.clips`), each frame with a reference.
"""

from __future__ import annotations

import hashlib
import re
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata import __version__
from eldata.base.files import (
    atomic_write,
    json_text,
    refuse_among,
    remove_leftovers,
    visible_below,
    write_json,
    write_text,
)
from eldata.base.numbers import checked_number, simplest_fraction
from eldata.base.seeds import checked_seed, item_generator, purpose_sequence
from eldata.base.workers import AnyWorkers, Workers, require_files
from eldata.datasets.clean import CleanScene, clean_scenes
from eldata.datasets.crops import Crop
from eldata.datasets.synthetic.dark_frames import DarkFrames
from eldata.datasets.synthetic.draws import Turns
from eldata.datasets.synthetic.pairs import check_scale, draw_dark
from eldata.errors import ArgumentError, DatasetError, EldataError, RawFileError, check_choice
from eldata.manifest.card import OWN_PROTOCOL, CameraCard, Card, cfa_word
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.noise.components import parse_components
from eldata.noise.model import NoiseModel
from eldata.noise.parameters import NoiseDraw, NoiseParameters
from eldata.raw.dng import write_dng
from eldata.raw.levels import (
    cfa_from,
    pack_normalised,
    packed_area,
    packed_black_level_dn,
    packed_shape,
    packing_sites,
    unpack,
)
from eldata.raw.reading import read_raw
from eldata.records import Exposure, FrameRecord, RawFrame
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.noise.profile import CameraProfile, RowChoice

Format = Literal["dng", "npy"]
_NOISE, _SPLIT = 6, 7  # purposes of random numbers
_BEGUN = ".begun"


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
    iso, row, extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`. The noisy frames state this ISO; without one the whole ISO that
        belongs to the drawn K, or the clean frame's where the profile knows none.
    per_image
        Noisy frames per clean one; of clips, noisy clips per clean one.
    clips
        ``True``: each folder that holds raws is a clip (:class:`~eldata.datasets.CleanClips`); parameters and ratio are
        drawn once for it, and the noise afresh for each frame (K. Wei et al., TPAMI 2021, section 4.6).
        ``False``: they are drawn for each frame. ``None``: for each frame, and a folder below that may be either, with
        several raws whose names differ in numbers, is refused.
    split
        Shares of the splits ``train`` and ``test``, such as (95, 5), to which whole clips, or else scenes, are drawn by
        the seed; to the nearest whole number for ``test``. ``None``: no splits.
    format
        ``"dng"``: raw DN; ``"npy"``: packed (C, h, w) float32, normalised and amplified.
    dark_frames
        Of component D: a folder or a store of the camera's bias frames (:class:`~eldata.datasets.DarkFrames`). Each is
        used once before any is used twice. They are of one ISO, so ``iso`` is needed, and K is exactly that ISO's.
    """

    profile: CameraProfile
    spec: str = "P*+G*+B+R+U"
    ratio: tuple[float, float] = (100.0, 300.0)
    seed: int = 0
    iso: float | None = None
    row: RowChoice = "any"
    extrapolate: bool = False
    per_image: int = 1
    clips: bool | None = None
    split: tuple[float, float] | None = None
    format: Format = "dng"
    dark_frames: Path | None = None

    def __post_init__(self) -> None:
        low, high = self.ratio
        if not 0 < low <= high < 1e6:
            raise ArgumentError(f"ratio must be above 0, the lower first; found {low:g} to {high:g}")
        checked_seed(self.seed)
        if self.per_image < 1:
            raise ArgumentError(f"per_image must be 1 or more; found {self.per_image}")
        check_choice("format", self.format, get_args(Format))
        # Refuses now what the profile cannot be sampled with, and what a file cannot state.
        self.profile.sample(np.random.default_rng(0), iso=self.iso, row=self.row, extrapolate=self.extrapolate)
        if self.iso is not None and self.format == "dng" and not (float(self.iso).is_integer() and self.iso < 2**32):
            raise ArgumentError(
                f"a DNG states its ISO as a whole number of 32 bits; found {self.iso:g}. Choose a whole one, or "
                "format='npy' (--format npy)"
            )
        if self.dark_frames is not None:
            object.__setattr__(self, "dark_frames", Path(self.dark_frames).absolute())  # workers may stand elsewhere
            if self.iso is None:
                raise ArgumentError("noise is made with dark frames of one ISO; choose it with --iso (iso=...)")
        self.model(self.dark())

    @property
    def written_spec(self) -> str:
        """The components that are drawn; for DNG without U, because writing rounds."""
        names = parse_components(self.spec)
        if self.format == "dng":
            names = tuple(name for name in names if name != "U")
        if not names:
            raise ArgumentError("noise model 'U': writing a DNG rounds to whole DN already; name another component")
        return "+".join(names)

    def dark(self) -> DarkFrames | None:
        """Return the dark frames, newly opened: they are looked for in their folder."""
        if self.dark_frames is None or self.iso is None:
            return None
        return DarkFrames(self.dark_frames, isos=[self.iso])

    def model(self, dark: DarkFrames | None) -> NoiseModel:
        """Return the noise model, with dark frames that are open."""
        return NoiseModel(self.written_spec, dark_frames=dark)


def synthesize(
    clean: Path | Sequence[Path], out: Path, recipe: Recipe, *, reference: str | None = None, workers: AnyWorkers = 1
) -> Manifest:
    """Write a noisy tree for clean files; return its manifest.

    Whatever ends the work (an error, a full disk, Ctrl-C, kill -9) leaves whole files, and the same call goes on: files
    that are there are kept. The manifest comes last.

    Parameters
    ----------
    clean
        Folder, whose clean camera raws are taken, or a manifest, whose references are, be they raws or mosaics with a
        card (:class:`~eldata.datasets.CleanFrames`); or several. Each frame must state ISO and exposure time.
    out
        A new or empty folder, or one in which the same work was begun.
    recipe
        The noise.
    reference
        Pattern of the clean frames' paths below a folder; ``"*"`` takes all.
    workers
        Number of worker processes, or an executor (:mod:`eldata.base.workers`), whose workers then write below
        ``out``; the files do not depend on it.

    Raises
    ------
    DatasetError
        If ``clean`` holds no raw file, it is not certain which of a folder's are clean, or whether they are clips; if
        the frames of a clip differ in size, CFA, camera or exposure; if a file has other bits than those that the
        profile's figures are of; or if ``out`` holds something else.
    ArgumentError
        If ``out`` was begun with another recipe or other clean files, or lies in ``clean``; if a split leaves nothing
        to train or to test on.
    RawFileError
        If a clean file cannot be read, states no ISO or exposure time, or something that a DNG cannot hold.
    EldataError
        If a file cannot be written.
    """
    workers = Workers.of(workers)
    folders = [Path(clean)] if isinstance(clean, (str, Path)) else list(map(Path, clean))
    for folder in folders:
        refuse_among(out, folder)  # noisy frames would be clean ones when the same call goes on
    sources, dark = clean_scenes(folders, recipe.clips, reference), recipe.dark()
    splits = draw_splits(recipe.seed, recipe.split, sources[-1].drawn_for + 1)
    name = re.sub(r"[^\w.+-]", "-", out.resolve().name) or "synthetic"
    data = out / "data" / name
    if out.exists() and not out.is_dir():
        raise DatasetError(f"{out}: is not a folder; give a new one")
    work = _digest_work(recipe, sources, dark)
    try:
        _begin(out, work)
        for folder in (out / "manifests", data):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EldataError(f"cannot make {error.filename}: {error.strerror}") from error
    clean_facts: list[_CleanFacts] = []
    make = partial(_synthesize_file, Path.cwd(), data.absolute(), recipe, work)
    for source, facts in zip(sources, workers.run(make, sources, label="synthesizing"), strict=True):
        first = clean_facts[source.first] if source.first < len(clean_facts) else facts
        for field in fields(_CleanFacts):
            if (found := getattr(facts, field.name)) != (wanted := getattr(first, field.name)):
                raise DatasetError(
                    f"{source.path}: {field.name} {found}, but {sources[source.first].path} has {wanted}; is it of "
                    "that clip?"
                )
        clean_facts.append(facts)
    manifest = _write_tables(out, name, recipe, sources, splits, clean_facts, dark)
    (out / _BEGUN).unlink(missing_ok=True)  # another process may have done the same
    return manifest


def draw_splits(seed: int, shares: tuple[float, float] | None, count: int) -> list[str]:
    """Draw the split of each of so many scenes or clips, ``train`` or ``test``, by their shares; ``None``: no splits.

    Raises
    ------
    ArgumentError
        If a share is not above 0, or one of the splits would be empty.
    """
    if shares is None:
        return [""] * count
    train, test = (checked_number("split", share, above=0) for share in shares)
    held = round(count * test / (train + test))
    if not 0 < held < count:
        raise ArgumentError(
            f"split {train:g}:{test:g} of {count} scenes or clips leaves {held} to test on; give more, or other shares"
        )
    chosen = set(np.random.default_rng(purpose_sequence(seed, 0, _SPLIT)).permutation(count)[:held].tolist())
    return ["test" if number in chosen else "train" for number in range(count)]


def _begin(out: Path, work: str) -> None:
    """Prepare a new or empty folder for work, or go on with the same work in it."""
    out.mkdir(parents=True, exist_ok=True)
    remove_leftovers(out)
    path = out / _BEGUN
    if path.exists():
        if path.read_text(encoding="utf-8", errors="replace") != work:
            raise ArgumentError(
                f"{out}: was begun with another recipe, other clean or dark frames, or another version of eldata; give "
                "the same as then, or remove it to start again"
            )
    elif visible_below(out, deep=False):
        raise DatasetError(f"{out}: holds something already; give a new folder")
    else:
        write_text(path, work)


def _digest_work(recipe: Recipe, sources: Sequence[CleanScene], dark: DarkFrames | None) -> str:
    """Digest everything that decides the content of every file."""
    files, names = [source.path for source in sources], []
    if dark is not None and recipe.dark_frames is not None:
        names = list(dark.names(dark.isos[0]))
        files += [path for path in map(Path, names) if path.is_file()] or [recipe.dark_frames]  # or a store of them
    stamps = [(str(path), status.st_size, status.st_mtime_ns) for path in files for status in [path.stat()]]
    stated = [repr(source.file) for source in sources]  # with what a card states of it
    decides = [__version__, asdict(recipe) | {"dark_frames": None}, names, stamps, stated]
    return f"sha256:{hashlib.sha256(json_text(decides).encode()).hexdigest()}"


@lru_cache(maxsize=1)
def _open_dark_frames(path: Path, iso: float, _work: str) -> DarkFrames:
    """Open dark frames, once in a process as long as the work is the same."""
    return DarkFrames(path, isos=[iso])


def _choose_member(recipe: Recipe, dark: DarkFrames, index: int, copy: int) -> int:
    """Return the number of the dark frame whose turn it is."""
    (iso,) = dark.isos
    return Turns(recipe.seed, [1.0], [len(dark.names(iso))]).at(index * recipe.per_image + copy)[1][0]


def _write_tables(
    out: Path,
    name: str,
    recipe: Recipe,
    sources: Sequence[CleanScene],
    splits: Sequence[str],
    clean_facts: Sequence[_CleanFacts],
    dark: DarkFrames | None,
) -> Manifest:
    """Write the parameters, the card and the manifest, which comes last."""
    records: list[FrameRecord] = []
    drawn: list[dict[str, Any]] = []
    for source, clean in zip(sources, clean_facts, strict=True):
        base = f"{recipe.profile.camera}/{source.scene}"
        record = partial(
            FrameRecord, camera=recipe.profile.camera, scene=source.scene, split=splits[source.drawn_for],
            width=clean.width, height=clean.height,
        )  # fmt: skip
        reference = record(path=f"{base}/clean.dng", role="reference", iso=clean.iso, exposure_s=clean.exposure_s)
        records.append(reference)
        for copy in range(recipe.per_image):
            draw = _Draw.of(recipe, clean, source, copy)
            of_copy = record(path=f"{base}/{draw.name}", role="noisy", iso=draw.iso, exposure_s=draw.exposure_s)
            records.append(replace(of_copy, ratio=draw.ratio, reference=reference.path))
            parameters = draw.parameters.as_dict()
            drawn.append({"path": of_copy.path, "clean": str(source.path), "ratio": float(draw.ratio)} | parameters)
            if dark is not None:
                drawn[-1]["dark_frame"] = dark.names(dark.isos[0])[_choose_member(recipe, dark, source.number, copy)]
    roles = [record.role for record in records]
    card = Card(
        name=name,
        title=f"Synthetic noise of {recipe.profile.camera} on {len(sources)} clean frames"
        + (f" of {len(splits)} clips" if recipe.clips else ""),
        version="1.0",
        folder=name,
        citation="none: made by eldata synthesize",
        licence="that of the clean frames",
        homepage="made by eldata synthesize",
        cfa=cfa_word(clean.cfa for clean in clean_facts),
        cameras={recipe.profile.camera: CameraCard(tuple(sorted({clean.model for clean in clean_facts} - {""})))},
        counts={role: roles.count(role) for role in sorted(set(roles))},
        protocol="sequences" if recipe.clips else OWN_PROTOCOL,
        sources=(f"noise model {recipe.spec}, profile {recipe.profile.camera}: {recipe.profile.source}",),
    )
    parameters = {
        "model": recipe.spec,
        "written_model": recipe.written_spec,
        "profile": recipe.profile.as_dict(),
        "seed": recipe.seed,
        "ratio": list(recipe.ratio),
        "format": recipe.format,
        "frames": drawn,
    }
    write_json(out / "parameters.json", parameters, indent=1)
    return save_manifest(out / "manifests" / f"{name}.csv", card, records)


@dataclass(frozen=True, slots=True)
class _CleanFacts:
    """What a scene's rows and parameters need to know of its clean frame."""

    iso: Fraction
    exposure_s: Fraction
    width: int
    height: int
    model: str
    cfa: str


@dataclass(frozen=True, slots=True)
class _Draw:
    """The draw of one noisy copy, from (seed, place of the file or clip, number of the copy) alone."""

    name: str
    parameters: NoiseParameters
    ratio: Fraction
    iso: Fraction
    exposure_s: Fraction
    generator: np.random.Generator

    @classmethod
    def of(cls, recipe: Recipe, clean: _CleanFacts, source: CleanScene, copy: int) -> _Draw:
        """Draw a noisy file's parameters, ratio and exposure; its generator goes on to the noise."""
        generator = item_generator(recipe.seed, source.drawn_for, copy)
        parameters = recipe.profile.sample(generator, iso=recipe.iso, row=recipe.row, extrapolate=recipe.extrapolate)
        low, high = recipe.ratio
        ratio = Fraction(round(float(generator.uniform(low, high)) * 100), 100)
        iso = clean.iso  # where the profile knows of none
        if recipe.iso is not None:
            iso = simplest_fraction(recipe.iso)
        elif (of_gain := recipe.profile.iso_at_gain(parameters.gain_dn_per_e)) is not None:
            iso = Fraction(max(1, round(of_gain)))
        exposure_s = (clean.iso * clean.exposure_s / (iso * ratio)).limit_denominator(2**31)
        if source.moment:
            sequence = purpose_sequence(recipe.seed, source.drawn_for, _NOISE, copy, source.moment)
            generator = np.random.default_rng(sequence)
        return cls(f"noisy-{copy + 1}.{recipe.format}", parameters, ratio, iso, exposure_s, generator)


def _synthesize_file(start: Path, folder: Path, recipe: Recipe, work: str, source: CleanScene) -> _CleanFacts:
    """Write the files of a scene that are not there yet; each has its name once it is whole."""
    path, place = source.path, folder / recipe.profile.camera / source.scene
    require_files(start / path)
    raw = read_raw(source.below(start))
    raw.whole_dn("synthesis")
    frame = _crop_to_periods(raw)
    iso, exposure_s = frame.exposure.iso, frame.exposure.exposure_s
    if iso is None or exposure_s is None:
        raise RawFileError(
            path, f"states no {'ISO' if iso is None else 'exposure time'}, which the noisy frame's follows"
        )
    sensor = frame.sensor
    if recipe.profile.range_dn is not None:
        advice = "the noisy files are like the clean: take some of as many bits, or SyntheticPairs with range_dn="
        check_scale(str(path), sensor, recipe.profile.camera, recipe.profile.range_dn, advice)
    facts = _CleanFacts(iso, exposure_s, sensor.width, sensor.height, sensor.model, packing_sites(sensor.cfa).name)
    place.mkdir(parents=True, exist_ok=True)
    remove_leftovers(place)
    draws = enumerate(_Draw.of(recipe, facts, source, copy) for copy in range(recipe.per_image))
    waiting = [(copy, draw) for copy, draw in draws if not (place / draw.name).exists()]
    if not (place / "clean.dng").exists():
        with _name_in_errors(path):
            write_dng(place / "clean.dng", frame.mosaic, sensor, frame.exposure, compression="lossless-jpeg")
    if not waiting:
        return facts
    clean = pack_normalised(frame.mosaic, sensor.cfa, sensor.black_level_dn, sensor.white_level_dn)
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn).astype(np.float64)[:, None, None]
    range_dn = sensor.white_level_dn - float(black.mean())
    dark = None
    if recipe.dark_frames is not None and recipe.iso is not None:
        dark = _open_dark_frames(recipe.dark_frames, recipe.iso, work)
    model = recipe.model(dark)
    whole = Frame.of_raw(raw.mosaic, raw.sensor, str(path), raw.exposure)
    area = Crop.region(whole, (0, 0, *packed_shape(whole.shape, whole.cfa)[1:]))
    for copy, draw in waiting:
        members = () if dark is None else (_choose_member(recipe, dark, source.number, copy),)
        of_sensor = draw_dark(model, whole, area, recipe.iso, members, draw.generator)
        exposure = NoiseDraw(draw.parameters, float(draw.ratio), range_dn, dark=members)
        noisy = model.apply(clean, exposure, draw.generator, dark=of_sensor)
        if recipe.format == "dng":
            dn = draw.parameters.rounded(noisy.astype(np.float64) * (range_dn / exposure.ratio) + black)
            mosaic = unpack(np.clip(dn, 0, sensor.white_level_dn).astype(np.uint16), sensor.cfa)
            stated = Exposure(draw.iso, draw.exposure_s, frame.exposure.f_number)
            with _name_in_errors(path):
                write_dng(place / draw.name, mosaic, sensor, stated, compression="lossless-jpeg")
        else:
            with atomic_write(place / draw.name) as file:
                np.save(file, noisy, allow_pickle=False)
    return facts


@contextmanager
def _name_in_errors(path: Path) -> Iterator[None]:
    """Let what a DNG cannot hold name the clean file that states it, too."""
    try:
        yield
    except ArgumentError as error:
        raise RawFileError(path, f"cannot be a clean frame: {error}") from error


def _crop_to_periods(frame: RawFrame) -> RawFrame:
    """Return the part of a frame that packs, so that every pixel of the noisy one has its noise."""
    cfa = frame.sensor.cfa
    area = packed_area((frame.mosaic.shape[0], frame.mosaic.shape[1]), cfa)
    sensor = replace(frame.sensor, cfa=cfa_from(cfa, area.top, area.left), height=area.height, width=area.width)
    return replace(frame, mosaic=np.ascontiguousarray(frame.mosaic[area.slices]), sensor=sensor)
