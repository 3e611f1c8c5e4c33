"""A set's files from its repository on the Hugging Face hub, as far as the manifest lists them.

huggingface_hub fetches, into the hidden folder ``.eldata-hub`` of the dataset's folder. A broken connection goes on
where it broke, a run that ended early goes on with the next file. All files are of one commit. Each is held against the
hub's hash before it appears in its place.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import inside
from eldata.download.card_downloads import check_room, progress_bar
from eldata.download.installing import Installed, find_relocation
from eldata.download.unpacking import Unpacked
from eldata.errors import DownloadError
from eldata.manifest.patterns import is_pattern

if TYPE_CHECKING:
    from collections.abc import Iterator

    from huggingface_hub import RepoFile

    from eldata.manifest.card import Download
    from eldata.manifest.catalogue import Manifest

KEPT = ".eldata-hub"
_DATASET = re.compile(r"https://huggingface\.co/datasets/([\w-][\w.-]*/[\w-][\w.-]*)")


def hub_name(download: Download) -> str:
    """Return the name of a data set's repository on the hub, ``owner/name``; empty of other addresses."""
    found = _DATASET.fullmatch(download.address)
    return found[1] if found else ""


def fetch_repository(download: Download, manifest: Manifest, folder: Path) -> Installed:
    """Fetch the files of a repository that the manifest lists and that are not there.

    Returns
    -------
    Installed
        Files that are there already are compared with the hub's hash, and never replaced.

    Raises
    ------
    DownloadError
        If huggingface_hub is not installed, the hub cannot be reached or refuses, a file is not what the hub's hash
        says, or the disk is full. The files that have arrived are kept.
    ArchiveError
        If the repository has none of the listed files, or it cannot be told where they belong.
    ManifestError
        If a file would lie outside of the dataset's folder.
    """
    try:
        from huggingface_hub import HfApi, RepoFile, hf_hub_download
        from huggingface_hub.utils.tqdm import disable_progress_bars
    except ImportError as error:
        raise DownloadError(f"{download.address}: needs huggingface_hub: pip install 'eldata[hub]'") from error
    disable_progress_bars()  # there is one of all files
    name, kept = hub_name(download), folder / KEPT
    with _failures_named(download.address):
        api = HfApi(token=False)  # public sets alone: nobody's own token leaves this machine
        commit = api.repo_info(name, repo_type="dataset").sha
        tree = api.list_repo_tree(name, repo_type="dataset", revision=commit, recursive=True)
        files = {one.path: one for one in tree if isinstance(one, RepoFile)}
    places = _places(name, list(files), manifest, folder)
    there = {path for path, place in places.items() if os.path.lexists(place)}
    identical = {path for path in there if _fault(places[path], files[path]) == ""}
    missing = sorted(places.keys() - there)
    folder.mkdir(parents=True, exist_ok=True)
    check_room(folder, sum(files[path].size for path in missing), "still to come")
    with _failures_named(download.address), progress_bar(name, sum(files[path].size for path in missing)) as bar:
        for path in missing:
            fetched = Path(
                hf_hub_download(name, path, repo_type="dataset", revision=commit, local_dir=kept, token=False)
            )
            fault = _fault(fetched, files[path])
            if fault:
                fetched.unlink()  # going on from it would fail again
                raise DownloadError(f"{download.address}, {path}: {fault}; the same command fetches it again")
            places[path].parent.mkdir(parents=True, exist_ok=True)
            fetched.replace(places[path])
            bar.update(files[path].size)
        shutil.rmtree(kept, ignore_errors=True)
    done = Unpacked(tuple(missing), tuple(sorted(identical)), tuple(sorted(there - identical)))
    return Installed(Path(name), done, len(places), tuple(sorted(files.keys() - places.keys())))


def _places(name: str, paths: list[str], manifest: Manifest, folder: Path) -> dict[str, Path]:
    """Return where the files that the manifest lists belong."""
    listed = {record.path for record in manifest.records}
    patterns = [path for path in listed if is_pattern(path)]
    relocation = find_relocation(Path(name), paths, listed)
    places = {}
    for path in paths:
        target = relocation.target(path)
        if target is not None and (target in listed or any(fnmatchcase(target, pattern) for pattern in patterns)):
            places[path] = inside(folder, target)
    return places


def _fault(path: Path, file: RepoFile) -> str:
    """Return what of a file is not as the hub has it: size, or hash (of large files SHA-256, of others git's)."""
    if not path.is_file():
        return "is not a file"
    size = path.stat().st_size
    if size != file.size:
        return f"expected {file.size} bytes, found {size}"
    hashed = hashlib.sha256() if file.lfs else hashlib.sha1(b"blob %d\0" % size, usedforsecurity=False)
    with path.open("rb") as content:
        hashlib.file_digest(content, lambda: hashed)
    expected = file.lfs.sha256 if file.lfs else file.blob_id
    return "" if hashed.hexdigest() == expected else f"expected the hash {expected}, found {hashed.hexdigest()}"


@contextmanager
def _failures_named(address: str) -> Iterator[None]:
    from httpx2 import HTTPError, InvalidURL
    from huggingface_hub.errors import HfHubHTTPError

    try:
        yield
    except (HfHubHTTPError, HTTPError, InvalidURL, OSError) as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise DownloadError(
            f"{address}: {reason}; the files that have arrived are kept, and the same command goes on with the others"
        ) from error
