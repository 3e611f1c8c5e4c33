"""The raw files of the Raw Natural Image Noise Dataset (RawNIND), as its own script lays them out.

A name says filter array, scene, whether the file is a reference (GT), its ISO and its SHA-1. The script moves it to
``src/<filter array>/<scene>/``, a reference below ``gt``.

Sources: B. Brummer and C. De Vleeschouwer, arXiv 2501.08924; Dataverse's answer for doi:10.14428/DVN/DEQCIM, with
names and sizes, in CommReteris/rawnind_jddc, commit d364f8c, datasets/RawNIND/dataset.yaml; the authors' repository
trougnouf/rawnind_jddc, commit 4d455aa, datasets/RawNIND/organize_files.sh and src/rawnind/libs/rawds.py (limits of
alignment and mask). ``facts/rawnind.csv`` has names, sizes and what follows of alignment from a commit that a
contributor made there in a pull request, cf592a5, src/rawnind/datasets/RawNIND/RawNIND_masks_and_alignments.yaml:
``unaligned``, none is public or the authors' limit leaves it out; ``misaligned``, a shift is known.
"""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.errors import ManifestError
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from pathlib import Path

_NAME = re.compile(r"(Bayer|X-Trans)_(.+?)_(GT_)?ISO(.+)_sha1=[0-9a-f]{40}\.(\w+)")
_NO_SPEED = ("65535", "Hi 3200")  # what EXIF's 16 bits end at, and a name of a camera's own
_UNREAD = "crw"


def rawnind_records(facts: Path) -> tuple[FrameRecord, ...]:
    """Return the rows of the set, sorted by path, from the table of its files.

    The reference of a noisy frame is the first of its scene by name; the authors' code compares it with each.

    Raises
    ------
    ManifestError
        If a name has another form.
    """
    rows: list[FrameRecord] = []
    first_of: dict[str, str | None] = {}
    for file in TextFile(facts, ManifestError).rows(("name", "size_bytes", "flags")):
        if (said := _NAME.fullmatch(name := file.text("name"))) is None:
            raise ManifestError(f"{facts}: not the name of a raw file of RawNIND: {name!r}")
        cfa, scene, is_reference, iso, kind = said.groups()
        place, split = f"src/{cfa}/{scene}", "test" if "TEST_" in scene else "train"
        frame = FrameRecord(
            f"{place}/{name}", "noisy", cfa, scene, split, None if iso in _NO_SPEED else Fraction(iso),
            ratio=Fraction(1), size_bytes=file.whole("size_bytes"),
            flags=(*filter(None, [file.text("flags", empty=True)]), UNCERTAIN_ISO),
        )  # fmt: skip
        if is_reference:
            frame = replace(frame, path=f"{place}/gt/{name}", role="reference", ratio=None, flags=())
            first_of.setdefault(scene, None if kind == _UNREAD else frame.path)
        rows.append(frame)
    paired = (row if row.role == "reference" else replace(row, reference=first_of[row.scene]) for row in rows)
    return tuple(sorted(paired, key=lambda row: row.path))
