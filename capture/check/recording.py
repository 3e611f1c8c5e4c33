"""What was measured of each pair, into the manifest: :func:`write_measured`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.manifest.card import load_card
from eldata.manifest.table import MEASURED, load_records
from eldata.manifest.writing import save_manifest

if TYPE_CHECKING:
    from capture.check.result import CheckReport


def write_measured(manifest: Path | str, report: CheckReport) -> int:
    """Write the measured ratio and shift of the pairs of a report into their manifest, whole or not at all.

    Both columns of a pair that was checked are written, empty where nothing could be measured; rows that were not
    checked stay as they are.

    Parameters
    ----------
    manifest
        The manifest's CSV file.
    report
        Of :func:`capture.check.check`.

    Returns
    -------
    int
        The number of pairs whose ratio is recorded now.

    Raises
    ------
    ManifestError
        If the manifest is malformed.
    EldataError
        If it cannot be written.
    """
    path = Path(manifest)
    nothing: dict[str, Any] = dict.fromkeys(MEASURED)
    found = {pair.path: nothing | pair.recorded for group in report.groups for pair in group.pairs}
    records = [replace(one, **found.get(one.path, {})) for one in load_records(path)]
    save_manifest(path, load_card(path.with_suffix(".json")), records)
    return sum(found[one.path]["measured_ratio"] is not None for one in records if one.path in found)
