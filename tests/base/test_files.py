"""Atomic writing, hashing and paths that stay inside their root."""

from __future__ import annotations

import hashlib
import os
import re
import socket
from contextlib import nullcontext
from pathlib import Path

import pytest

from eldata.base.arrays import declared_array
from eldata.base.files import (
    atomic_write,
    file_problem,
    inside,
    path_problem,
    remove_leftovers,
    sha256_of,
    visible_below,
    write_problem,
    write_text,
)
from eldata.errors import EldataError, FileError, ManifestError
from tests.cases import in_one_test
from tests.syncing import OnDisk

OLD = b"old content"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "scores.csv"
    path.write_bytes(OLD)
    return path


def only(path: Path, content: bytes) -> bool:
    """The file has this content and its folder holds nothing else, so no ``.part`` either."""
    return path.read_bytes() == content and list(path.parent.iterdir()) == [path]


# --- what may be opened ---------------------------------------------------------------------------------------


def test_only_a_file_with_something_in_it_may_be_opened(tmp_path: Path) -> None:
    """A named pipe would be waited for; none of these is opened."""
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "empty").touch()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "device").symlink_to(os.devnull)
    os.mkfifo(tmp_path / "pipe")
    expected = {
        "file": None,
        "link": None,
        "empty": "is empty (0 bytes): copy or download it again",
        "loop": "cannot be read: Too many levels of symbolic links",
        "dangling": "cannot be read: No such file or directory",
        "nothing": "cannot be read: No such file or directory",
        "file/below": "cannot be read: Not a directory",
        "device": "is a pipe, device or socket, not a file",
        "pipe": "is a pipe, device or socket, not a file",
        ".": "is a folder, not a file",
        "nul\0": "cannot be read: its name holds a NUL character",
    }
    assert {name: file_problem(tmp_path / name) for name in expected} == expected
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert file_problem(tmp_path / "socket") == "is a pipe, device or socket, not a file"


@in_one_test(
    "content, words",
    [
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 25165824\n",
            "is a pointer of Git LFS to a file of 25165824 bytes: fetch that one with git lfs pull",
        ),
        (b"/annex/objects/SHA256E-s12--ab.dng\n", "is a pointer of git-annex: fetch the file itself"),
        (b"../.git/annex/objects/xX/SHA256E-s12--ab.dng", "is a pointer of git-annex: fetch the file itself"),
        (b"\xef\xbb\xbf\n<!DOCTYPE html><title>Quota exceeded</title>", "is a web page (HTML or XML)"),
        (b"<?xml version='1.0'?><Error><Code>AccessDenied</Code></Error>", "is a web page (HTML or XML)"),
        (b"\0\5\x16\7\0\2\0\0Mac OS X        ", "is what macOS puts beside a file (AppleDouble)"),
        (b"path,role\n<html>", None),
        (b"<headless>", None),
    ],
)
def test_what_stands_in_place_of_data_is_named(content: bytes, words: str | None, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    problem = file_problem(tmp_path / "a.npy")
    assert (problem or "").startswith(words or "")
    assert (problem is None) == (words is None)
    if problem is not None:
        with pytest.raises(FileError, match=re.escape(problem)):
            declared_array(tmp_path / "a.npy")


def test_hidden_files_are_passed_over_and_links_not_followed(tmp_path: Path) -> None:
    for name in ("b/c.dng", "b/._c.dng", "._b.dng", ".git/d.dng", "a.dng/e.npy"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "link").symlink_to(tmp_path / "b")
    assert visible_below(tmp_path) == [tmp_path / name for name in ("a.dng", "a.dng/e.npy", "b", "b/c.dng", "link")]
    assert visible_below(tmp_path, deep=False) == [tmp_path / name for name in ("a.dng", "b", "link")]
    assert visible_below(tmp_path / "none") == []


# --- atomic_write -------------------------------------------------------------------------------------------


def test_a_new_file_is_on_the_disk_before_it_takes_the_old_ones_place(
    old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = OnDisk(monkeypatch)
    with atomic_write(old) as file:
        file.write(b"short enough to wait in a buffer")
    assert disk.named == {old.name: True}


@in_one_test("error", [ValueError("x"), KeyboardInterrupt()])
def test_an_error_inside_leaves_the_old_file_alone(error: BaseException, old: Path) -> None:
    def write() -> None:
        with atomic_write(old) as file:
            file.write(b"new content" * 1000)
            raise error

    with pytest.raises(type(error)):
        write()
    assert only(old, OLD)


def leftovers(folder: Path) -> int:
    return len(list(folder.glob(".*.part")))


def test_what_is_being_written_is_not_a_leftover(old: Path) -> None:
    """Two writers of one file, and somebody who tidies: neither takes the other's away, and the last one wins."""
    old.with_name(f".{old.name}.eldata.part").write_bytes(b"of a process that was killed")
    with atomic_write(old) as first:
        first.write(b"first")
        with atomic_write(old) as second:
            second.write(b"second")
            assert leftovers(old.parent) == 2
            remove_leftovers(old.parent)
            assert leftovers(old.parent) == 2
        assert old.read_bytes() == b"second"
    assert only(old, b"first")


def test_leftovers_of_a_folder_are_removed_and_nothing_else(tmp_path: Path) -> None:
    dead = [".a.csv.eldata.part", ".b.csv.0123456789abcdef.part", "..begun.json.eldata.part"]
    others = ["a.csv", "a.csv.part", ".a.csv.part", ".a.csv.123.part", "store.h5.part", ".eldata.part", "c.eldata.part"]
    for name in dead + others:
        (tmp_path / name).write_bytes(OLD)
    (tmp_path / ".folder.eldata.part").mkdir()
    (tmp_path / ".link.eldata.part").symlink_to(tmp_path / "a.csv")
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [*others, ".folder.eldata.part", ".link.eldata.part"]
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("size", [10, 1_000_000])
def test_a_disk_that_is_full_when_it_is_written(size: int, old: Path) -> None:
    def write() -> None:
        with atomic_write(old) as file, Path("/dev/full").open("wb") as full:
            os.dup2(full.fileno(), file.fileno())
            file.write(b"x" * size)

    with pytest.raises(EldataError, match=r"cannot write .*scores\.csv: No space left on device"):
        write()
    assert only(old, OLD)


TARGETS = {
    "new": ("new.csv", None),
    "old": ("scores.csv", None),
    "link-to-nothing": ("nothing", None),
    "longest-name": ("x" * 232, None),
    "no-folder": ("a/b/new.csv", "there is no folder"),
    "folder": ("folder", "is a folder, not a file"),
    "file-as-folder": ("scores.csv/new.csv", "is not a folder"),
    "too-long-with-what-is-added": ("x" * 250, "File name too long"),
    "nul": ("a\0b", "null byte"),
}


@pytest.mark.parametrize("kind", TARGETS)
def test_what_cannot_be_written_is_known_before_and_nothing_is_touched(kind: str, old: Path) -> None:
    """A problem is stated where writing fails, and only there."""
    folder = old.parent
    (folder / "folder").mkdir()
    (folder / "nothing").symlink_to("none")
    before = sorted(folder.rglob("*"))
    name, expected = TARGETS[kind]
    problem = write_problem(folder / name)
    assert sorted(folder.rglob("*")) == before
    assert (expected or "") in (problem or "")
    assert (expected is None) == (problem is None)
    with nullcontext() if expected is None else pytest.raises((EldataError, ValueError)):
        write_text(folder / name, "x")


# --- sha256_of ----------------------------------------------------------------------------------------------


def test_sha256_is_that_of_the_bytes(tmp_path: Path) -> None:
    for content in (b"", bytes(range(256)) * 20_000):
        (tmp_path / "a").write_bytes(content)
        assert sha256_of(tmp_path / "a") == "sha256:" + hashlib.sha256(content).hexdigest()
    (tmp_path / "a").write_bytes(b"abc")  # FIPS 180-2, appendix B.1
    assert sha256_of(tmp_path / "a") == "sha256:ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(IsADirectoryError, match=tmp_path.name):
        sha256_of(tmp_path)


# --- path_problem and inside --------------------------------------------------------------------------------

SAFE = ["SonyA7S2/scene-1/IMG_0004.ARW", "scene 1/ä.dng", "..a/b..", ".hidden", "...", "a/b:c", "~/a", "-rf", "a" * 200]
UNSAFE = {
    "more than 255 characters": ["a/" + "b" * 256],
    "more than 4096 characters": ["abc/" * 1024 + "d"],
    "is empty": [""],
    "is absolute": ["/etc/passwd", "//server/share", "/"],
    "'..' part": ["..", "../a", "a/../../b", "a/..", ".", "a/./b", "./a", "a//b", "a/"],
    "backslash": ["a\\b", "..\\a", "C:\\a"],
    "drive": ["C:/a", "c:a"],
    "control character": ["a\nb", "a\0b", "a\x7f", "\ta"],
}


@in_one_test("path, problem", [(path, problem) for problem, paths in UNSAFE.items() for path in paths])
def test_unsafe_paths(path: str, problem: str, tmp_path: Path) -> None:
    assert problem in (path_problem(path) or "")
    with pytest.raises(ManifestError, match=re.escape(f"path {path!r} ")):
        inside(tmp_path, path)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A dataset's folder with a file, a sibling whose name starts alike, and a file outside."""
    root = tmp_path / "data"
    (root / "scene-1").mkdir(parents=True)
    (root / "scene-1" / "a.ARW").write_bytes(b"raw")
    (tmp_path / "data-other").mkdir()
    (tmp_path / "data-other" / "a.ARW").write_bytes(b"other")
    (tmp_path / "secret").write_bytes(b"secret")
    return root


def test_files_and_links_inside(root: Path) -> None:
    (root / "b.ARW").symlink_to(root / "scene-1" / "a.ARW")
    (root / "c").symlink_to("scene-1")
    (root / "scene-1" / "up").symlink_to("..")
    (root / "dangling").symlink_to("scene-1/not yet there")
    for path in ("scene-1/a.ARW", "b.ARW", "c/a.ARW", "scene-1/up/c/a.ARW", "dangling", "not/yet/there", *SAFE):
        assert path_problem(path) is None
        assert inside(root, path) == root / path


@pytest.mark.parametrize(
    ("link", "target", "path"),
    [
        ("leak", "../secret", "leak"),
        ("leak", "/", "leak/etc/passwd"),
        ("leak", "../data-other", "leak/a.ARW"),  # its path begins with the root's as text
        ("leak", "../gone", "leak"),
        ("leak", "../gone", "leak/deeper"),
        ("leak", "first/../../secret", "leak"),  # by way of another link
        ("leak", "leak", "leak/a.ARW"),  # a loop
    ],
)
def test_a_link_that_leads_outside_is_refused(link: str, target: str, path: str, root: Path) -> None:
    (root / "first").symlink_to("scene-1")
    (root / link).symlink_to(target)
    with pytest.raises(ManifestError, match=r"leads outside of|is it a loop of links") as caught:
        inside(root, path)
    assert path in str(caught.value)
