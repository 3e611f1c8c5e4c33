"""One call: a set's pairs, as one published repository's code reads them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from eldata.errors import check_choice
from eldata.integrations.exports.codes import CODES, planned
from eldata.integrations.exports.frames import exported_pairs
from eldata.integrations.exports.writing import write_export

if TYPE_CHECKING:
    from eldata.base.workers import AnyWorkers
    from eldata.integrations.exports.codes import Code
    from eldata.integrations.exports.writing import ExportReport, Linking
    from eldata.manifest.pairs import Choice


def export(
    code: Code,
    folder: Path | str,
    name: str = "",
    *,
    manifest: Path | str | None = None,
    root: Path | str | None = None,
    link: Linking = "symbolic",
    workers: AnyWorkers = 1,
    **choice: Unpack[Choice],
) -> ExportReport:
    """Write what a published repository's code reads of a set: links under its names, and its lists or infos.

    Parameters
    ----------
    code
        ``"led"``, ``"pmn"``, ``"eld"`` or ``"sid"``: the code of the repository of that name.
    folder
        Where to write. Nothing in it is overwritten, and what is there as wanted is left.
    name
        A set that eldata knows.
    manifest
        A manifest's CSV file, in place of the name.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    link
        ``"symbolic"`` or ``"hard"`` links to the files, or ``"copy"``. PMN's infos name the files themselves.
    workers
        Number of processes that read the files' headers, or an executor.
    choice
        Which pairs.

    Raises
    ------
    ArgumentError
        If an argument is unknown, or the code's names cannot say what the manifest does.
    ManifestError
        If there is no such set, or the manifest is malformed.
    DatasetError
        If files are missing or cannot be read.
    EldataError
        If something else lies where a link or list is to be; nothing is written then.

    Examples
    --------
    >>> from eldata.integrations.exports import export
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> report = export("led", "for-led", manifest=manifest, root="eldata-demo/data")
    >>> report.pairs, report.lists[0]
    (24, 'DemoAlpha/DemoAlpha_list.txt')
    """
    check_choice("code", code, CODES)
    _, pairs = exported_pairs(name, manifest=manifest, root=root, with_sensors=code == "pmn", workers=workers, **choice)
    return write_export(Path(folder), planned(code, pairs), sum(map(len, pairs.values())), link)
