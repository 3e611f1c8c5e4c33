"""Hold what is read of raw files against exiftool: ``python -m tests.raw.truth_table FOLDER...``, by hand.

exiftool (https://exiftool.org) must be installed. One line a file, and one for each field that differs; exit code 1
if any does. A file whose pixels are missing, such as the heads in exiftool's own t/images, is compared in what it
states of camera and exposure. docs/raw-files.md sums up what came out of the files that were tried (of 1 and
8, tests/raw/real has parts, with their licences):

- DNG: 1 gopro/gpr Fusion GPBK7066 converted to DNG (GoPro Fusion); 2 syoyo/tinydng colorchart.dng (Canon Kiss X4,
  converted); 3 imageio/test_images Blackmagic.dng (Pocket Cinema Camera 4K); 4 bep/imagemeta sample.dng (Canon SD450;
  head, noise for pixels); 5 Exiv2/exiv2 IMG_1361.dng (iPhone 12 Pro); 6 photoprism/photoprism canon_eos_6d.dng
  (linear); 7 exiftool/exiftool DNG.dng (Canon 350D).
- CR3: 8 mindeng/nom-exif canon-r6.cr3; 9 Exiv2/exiv2 Canon-R6-pruned.CR3; 10 exiftool/exiftool CanonRaw.cr3 (M50).
- CR2: 14 exiftool/exiftool CanonRaw.cr2 (350D); 15 bep/imagemeta sample.cr2 (Canon S90).
- NEF: 16 bep/imagemeta sample.nef (Nikon D1); 17 exiftool/exiftool Nikon.nef (D70).
- ARW, RAF: 18 bep/imagemeta sample.arw (Sony A330); 19 exiftool/exiftool FujiFilm.raf (S5 Pro);
  20 mindeng/nom-exif fujifilm_x_t1_01.raf.meta (exiftool reads nothing of it: cut off inside its JPEG).
- RW2, PEF, IIQ, MRW: 21 exiftool/exiftool Panasonic.rw2 (LX3); 22 bep/imagemeta jølstravatnet.pef (Pentax K-3 II);
  23 exiftool/exiftool PhaseOne.iiq (Leaf Credo 40); 24 exiftool/exiftool Minolta.mrw (DiMAGE A2).
- KDC, GPR: 25 letmaik/rawpy RAW_KODAK_DC50_é.KDC; 26 to 29 gopro/gpr GPBK7066, GPFR7066 (Fusion), GOPR0024 (Hero6),
  GOPR9231 (Hero7); 30 evanoberholster/imagemeta Hero8.GPR.
- X3F: 31, 32 exiftool/exiftool Sigma.x3f (SD10), SigmaDP2.x3f.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import EldataError
from eldata.raw.container import read_container
from eldata.raw.dng import write_dng
from eldata.raw.files import RAW_EXTENSIONS
from eldata.raw.reading import read_raw
from eldata.records import Exposure

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from eldata.records import RawFrame, RawHeader

# Where exiftool has a field more than once: the camera's EXIF, before what makers add and what exiftool works out.
_GROUPS = ("ExifIFD", "IFD0", "Canon", "Nikon", "Composite")
_TOLERANCE = 1e-5  # exiftool prints floats
_COLOURS = "RGBCMYW"


def exiftool(path: Path) -> dict[str, Any]:
    """What exiftool says, numbers as numbers, by group and name."""
    command = [shutil.which("exiftool") or "exiftool", "-j", "-n", "-a", "-G1", "-q", "-q", str(path)]
    said = subprocess.run(command, capture_output=True, check=False).stdout
    return dict(json.loads(said or b"[{}]")[0])


def stated(said: dict[str, Any], name: str) -> Any:
    """The field of the first group that has it; ``None`` where it is empty or 0, which states nothing."""
    for group in _GROUPS:
        value = said.get(f"{group}:{name}")
        if value not in (None, "", 0, "undef", "inf"):
            return value
    return None


def _number(value: Any) -> float | None:
    return None if value is None else float(str(value).split()[-1]) or None


def _same(ours: Fraction | float | None, theirs: float | None) -> bool:
    if ours is None or theirs is None:
        return ours is None and theirs is None
    return abs(float(ours) - theirs) <= _TOLERANCE * theirs


def differences(header: RawHeader, said: dict[str, Any]) -> Iterator[str]:
    """The fields that differ from exiftool's, with both values."""
    for name, text in (("Make", header.make), ("Model", header.model)):
        theirs = str(stated(said, name) or "").strip()
        if name == "Model" and not theirs and not header.make:
            theirs = str(stated(said, "UniqueCameraModel") or "")
        if text != theirs:
            yield f"{name}: {text!r}, exiftool {theirs!r}"
    exposure = header.exposure
    for name, ours in (("ISO", exposure.iso), ("ExposureTime", exposure.exposure_s), ("FNumber", exposure.f_number)):
        number = _number(stated(said, name))
        if name == "ISO" and number == 65535:
            number = _number(stated(said, "RecommendedExposureIndex"))
        if not _same(ours, number):
            yield f"{name}: {ours}, exiftool {number}"
    taken = "" if header.taken is None else f"{header.taken:%Y:%m:%d %H:%M:%S}"
    if taken != str(stated(said, "DateTimeOriginal") or "").replace("0000:00:00 00:00:00", ""):
        yield f"DateTimeOriginal: {taken!r}, exiftool {stated(said, 'DateTimeOriginal')!r}"


def sensor_differences(frame: RawFrame, said: dict[str, Any]) -> Iterator[str]:
    """The same of the sensor, for what a DNG or TIFF states with exiftool's tags of one meaning."""
    sensor = frame.sensor
    raw = next((key[: key.index(":")] for key, value in said.items() if "Photometric" in key and value == 32803), "")
    pattern = said.get(f"{raw}:CFAPattern2")
    if pattern is not None and f"{raw}:ActiveArea" not in said:
        theirs = "".join(_COLOURS[int(colour)] for colour in str(pattern).split())
        letters = "".join("RGBG"[index] for row in sensor.cfa for index in row)
        if letters != theirs:
            yield f"CFA: {letters}, exiftool {theirs}"
    black = said.get(f"{raw}:BlackLevel")
    if black is not None and sorted({*map(float, str(black).split())}) != sorted({*sensor.black_level_dn}):
        yield f"black: {sensor.black_level_dn}, exiftool {black}"
    white = said.get(f"{raw}:WhiteLevel")
    if white is not None and float(str(white).split()[0]) != sensor.white_level_dn:
        yield f"white: {sensor.white_level_dn}, exiftool {white}"
    matrices = [said[key] for key in ("IFD0:ColorMatrix1", "IFD0:ColorMatrix2") if key in said]
    ours = [] if sensor.xyz_to_camera is None else [value for row in sensor.xyz_to_camera for value in row]
    if matrices and not any(np.allclose(ours, [float(text) for text in matrix.split()]) for matrix in matrices):
        yield f"matrix: {sensor.xyz_to_camera}, exiftool {matrices}"
    neutral = said.get("IFD0:AsShotNeutral")
    if neutral is not None and sensor.white_balance is not None:
        red, green, blue = map(float, neutral.split())
        if not np.allclose(sensor.white_balance, (green / red, 1, green / blue, 1), rtol=_TOLERANCE):
            yield f"white balance: {sensor.white_balance}, exiftool's neutral {neutral}"


def round_trip(frame: RawFrame) -> str:
    """Write the frame as a DNG, read it again, and say what came back."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.dng"
        try:
            write_dng(copy, frame.mosaic, frame.sensor, frame.exposure)
            again = read_raw(copy)
        except EldataError as error:
            return f"not written back: {str(error).replace(folder, '')}"
    same = np.array_equal(again.mosaic, frame.mosaic) and again.sensor == frame.sensor
    return "written back, equal" if same and again.exposure == frame.exposure else "written back, NOT equal"


def main(folders: list[str]) -> int:
    wrong = 0
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*"))
    for path in paths:
        if path.suffix.lower() not in RAW_EXTENSIONS:
            continue
        said = exiftool(path)
        found: list[str] = []
        try:
            header = read_container(path).header
            if header.make or header.exposure != Exposure(None, None, None):
                found += differences(header, said)
            summary = f"{header.make or '-'}, {header.model or '-'}, {header.exposure}, {header.taken}"
        except EldataError as error:
            summary = f"refused: {error}"
        try:
            frame = read_raw(path)
            found += sensor_differences(frame, said)
            pixels = f"{frame.sensor}; {round_trip(frame)}"
        except EldataError as error:
            pixels = f"pixels refused: {error}"
        print(f"{path.name}\n    {summary}\n    {pixels}")
        for line in found:
            print(f"    DIFFERS {line}")
        wrong += bool(found)
    print(f"{wrong} files differ")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
