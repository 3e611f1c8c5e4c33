from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from eldata.download.fetching import RangeDownloader, fetch_archive
from eldata.manifest.card import CameraCard, Card, Download, save_card
from eldata.manifest.table import save_records
from eldata.records import FrameRecord

HASTY = RangeDownloader(tries=3, longest_wait_s=0.001, silence_s=5, plain_http=True)


def fetch(
    address: str, target: Path, downloader: RangeDownloader = HASTY, *,
    size_bytes: int | None = None, sha256: str | None = None,
) -> Path:  # fmt: skip
    """Fetch as a card with this one download says, into the data root whose folder of archives ``target`` lies in."""
    download = Download(address, size_bytes, direct=True, sha256=sha256)
    return fetch_archive(download, target.parent.parent, downloader)


def noise(size: int, seed: int = 0) -> bytes:
    return np.random.default_rng(seed).bytes(size)


def file_names() -> list[str]:
    shots = (("long", "10s"), ("short", "0.1s"))
    return [f"Sony/{kind}/0000{scene}_00_{time}.ARW" for scene in range(1, 4) for kind, time in shots]


def contents(size: int = 3000) -> dict[str, bytes]:
    return {name: noise(size + index, index) for index, name in enumerate(file_names())}


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def sevenzipped(files: dict[str, bytes], *, encoded_header: bool = True) -> bytes:
    import py7zr

    buffer = io.BytesIO()
    with py7zr.SevenZipFile(buffer, "w") as archive:
        archive.set_encoded_header_mode(encoded_header)
        for name, content in files.items():
            archive.writestr(content, name)
    return buffer.getvalue()


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def make_shelf(folder: Path, *downloads: Download) -> Path:
    """Write a folder of manifests such as the shipped ones, with one small dataset called ``small``."""
    folder.mkdir(parents=True, exist_ok=True)
    records = [FrameRecord(name, "noisy", "SonyA7S2", scene="1", split="test") for name in file_names()]
    save_records(folder / "small.csv", records)
    save_card(folder / "small.json", small_card(*downloads))
    return folder


def small_card(*downloads: Download) -> Card:
    texts = ("A. Author, A Paper, 2018", "MIT", "https://example.org/small", "bayer")
    cameras, counts = {"SonyA7S2": CameraCard(("ILCE-7SM2",))}, {"noisy": len(file_names())}
    card = Card("small", "Small set", "1.0", "SID", *texts, cameras, counts, downloads=downloads)
    return replace(card, known_defects=("Frame 3 is blurred.",), sources=("The paper.",))
