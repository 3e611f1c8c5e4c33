"""Verification: every way in which people's copies are wrong is found, named with what to do, and nothing else is.

Most tests start from a good copy (``tree``), damage it in one way, and compare all that is reported: a second report
of the same damage, or one of a file that is fine, fails as a missing one does.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import pytest

from eldata.base.workers import Workers
from eldata.errors import ArgumentError, ManifestError
from eldata.manifest.catalogue import data_root, find_manifests, shipped_manifest
from eldata.manifest.lock import lock
from eldata.manifest.table import save_records
from eldata.manifest.verify import check_files, verify
from eldata.manifest.verify_report import Level, Problem, VerifyReport
from eldata.records import Exposure
from tests.trees import ALPHA, BETA, Tree, flip_compressed_byte, frame, retake, scale_exposure, swap

REFERENCES = (1, 6, 11, 16)


def check(tree: Tree, level: Level = "metadata", **options: object) -> VerifyReport:
    return verify([tree.manifest], tree.root, level=level, **options)  # type: ignore[arg-type]


def found(report: VerifyReport) -> list[tuple[str, str]]:
    """Path and field of each problem."""
    return [(problem.path, problem.field) for problem in report.problems]


def only(report: VerifyReport) -> Problem:
    assert len(report.problems) == 1, report.format_text()
    return report.problems[0]


# --- reports ------------------------------------------------------------------------------------------


def test_the_same_wrong_exposure_in_many_files_is_one_problem_and_a_count(tree: Tree) -> None:
    off = [replace(one, exposure_s=one.exposure_s and one.exposure_s * Fraction(5, 4)) for one in tree.manifest.records]
    off[3] = replace(off[3], exposure_s=Fraction(1, 3))  # and one that is off otherwise
    save_records(tree.csv, off)
    report = check(tree, "metadata")
    lines = report.format_text().splitlines()
    assert len(report.problems) == 32
    assert [line for line in lines if line.endswith(": exposure_s")] == [
        f"{frame(1)} and 30 others alike: exposure_s",
        f"{frame(4)}: exposure_s",
    ]
    assert lines[2] == "    found     4 there; in all 31 files 80 % of what is expected"


def test_sizes_that_differ_by_file_are_one_problem_with_their_range(tree: Tree) -> None:
    rows = [replace(row, size_bytes=tree.file(1).stat().st_size + n) for n, row in enumerate(tree.manifest.records)]
    save_records(tree.csv, rows)
    sizes = [(tree.data / row.path).stat().st_size for row in rows]
    report, base = check(tree, "quick"), sizes[0]
    wrong = [n for n, size in enumerate(sizes) if size != base + n]
    assert len(wrong) == len(report.problems) > 20
    lines = report.format_text().splitlines()
    found = [sizes[n] for n in wrong]
    assert lines[:3] == [
        f"{rows[wrong[0]].path} and {len(wrong) - 1} others alike: size_bytes",
        f"    expected  {base + wrong[0]}..{base + wrong[-1]} bytes",
        f"    found     {min(found)}..{max(found)} bytes",
    ]
    assert len(lines) == 5


def test_two_files_of_wrong_sizes_are_one_problem_that_names_both(tree: Tree) -> None:
    rows = [replace(row, size_bytes=(tree.data / row.path).stat().st_size) for row in tree.manifest.records]
    rows[:2] = [replace(row, size_bytes=row.size_bytes + 5) for row in rows[:2] if row.size_bytes]
    save_records(tree.csv, rows)
    lines = check(tree, "quick").format_text().splitlines()
    assert lines[0] == f"{rows[0].path}, {rows[1].path}: size_bytes"
    assert len(lines) == 5


def test_reports_do_not_depend_on_the_number_of_jobs(tree: Tree) -> None:
    """Results come back in order from worker processes, and what they say survives the way."""
    tree.file(2).write_bytes(tree.file(2).read_bytes()[:-4000])
    retake(tree.file(3), model="Demo Beta")
    swap(tree.file(6), tree.file(7))
    tree.file(9, BETA).unlink()
    alone = check(tree, "full", workers=1)
    assert len(alone.problems) >= 4
    assert check(tree, "full", workers=2) == alone


def test_the_root_comes_from_the_environment(pristine: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """--root wins over $ELDATA_ROOT, which wins over ./data."""
    monkeypatch.delenv("ELDATA_ROOT", raising=False)
    assert data_root() == Path("data")
    monkeypatch.setenv("HOME", str(pristine.root.parent))
    assert verify([pristine.manifest], f"~/{pristine.root.name}").ok, "of --root=~/data a shell leaves the tilde"
    monkeypatch.setenv("ELDATA_ROOT", str(pristine.root))
    assert verify(pristine.csv).ok
    assert data_root("other") == Path("other")


# --- one thing wrong --------------------------------------------------------------------------------------------------

NOISY, UNLISTED = frame(4), ("IMG_0020.ARW", "IMG_0020.cr2", "extra.NEF")


def cut(tree: Tree) -> None:
    os.truncate(tree.file(4), tree.file(4).stat().st_size * 9 // 10)


def unlist(tree: Tree) -> None:
    for name in UNLISTED:
        shutil.copy(tree.file(1), tree.data / ALPHA / name)


def link_outside(tree: Tree, *, dangling: bool = False) -> None:
    """A manifest must not make us read (or hash and publish) somebody's other files."""
    outside = tree.file(4).rename(tree.root.parent / "outside.dng")
    tree.file(4).symlink_to(outside)
    if dangling:
        outside.unlink()


def put_folder(tree: Tree) -> None:
    tree.file(4).unlink()
    tree.file(4).mkdir()


def moved(to: str) -> Callable[[Tree], object]:
    return lambda tree: shutil.move(tree.data / "DemoBeta", tree.data / to)


def take(number: int, iso: int | None, exposure_s: Fraction | None) -> Callable[[Tree], None]:
    return lambda tree: retake(tree.file(number), exposure=Exposure(None if iso is None else Fraction(iso), exposure_s))


@pytest.mark.parametrize(
    ("damage", "level", "expected"),
    [
        (lambda tree: shutil.rmtree(tree.data / BETA), "quick", [(f"{BETA}/", "folder", "no such folder")]),
        (moved("demobeta"), "quick", [("DemoBeta/", "folder", "only demobeta/")]),
        (moved("more/DemoBeta"), "quick", [("DemoBeta/", "folder", f"{frame(1, BETA)} in another place, more/Demo")]),
        (put_folder, "quick", [(NOISY, "file", "a folder")]),
        (unlist, "quick", [(f"{ALPHA}/{name}", "file", "19 raw files, this one unlisted") for name in UNLISTED]),
        (link_outside, "quick", [(NOISY, "path", "a link outside")]),
        (partial(link_outside, dangling=True), "quick", [(NOISY, "path", "a link outside")]),
        (cut, "metadata", [(NOISY, "content", "")]),
        # Exposed accordingly: the ratio alone would not tell.
        (take(4, 1600, Fraction(1, 400)), "metadata", [(NOISY, "iso", "1600"), (NOISY, "exposure_s", "0.0025")]),
        (take(6, None, Fraction(4)), "metadata", [(frame(6), "exposure", "no ISO")]),
        (take(6, 100, None), "metadata", [(frame(6), "exposure", "no exposure time")]),
    ],
)
def test_one_thing_wrong_is_named_once(
    damage: Callable[[Tree], object], level: Level, expected: list[tuple[str, str, str]], tree: Tree
) -> None:
    damage(tree)
    problems = check(tree, level).problems
    assert found(check(tree, level)) == [(path, field) for path, field, _ in expected]
    assert all(problem.found.startswith(text) for problem, (*_, text) in zip(problems, expected, strict=True))
    assert level == "quick" or check(tree, "quick").ok, "no size is recorded: only the content tells"


# --- presence -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [0, -1])
def test_a_folder_of_another_name_is_known_by_any_of_its_files(index: int, pristine: Tree, tmp_path: Path) -> None:
    manifest = pristine.manifest
    for name in ("other", "another"):
        file = tmp_path / name / manifest.records[index].path
        file.parent.mkdir(parents=True)
        file.touch()
        if name == "other":
            assert manifest.folder(tmp_path) == tmp_path / name
    with pytest.raises(ManifestError, match="each of these folders does"):
        manifest.folder(tmp_path)


@pytest.mark.parametrize(("name", "folder"), [("eld", "ELD"), ("sid-fuji", "SID/Fuji")])
def test_an_absent_dataset_is_named_once_and_is_no_problem(name: str, folder: str, tmp_path: Path) -> None:
    """Who verifies a folder of manifests does not have every dataset, and SID's Sony half may be there alone."""
    (tmp_path / "SID" / "Sony").mkdir(parents=True)
    report = verify([shipped_manifest(name)], tmp_path, level="full")
    assert (report.problems, report.ok) == ((), False)
    first, second = report.format_text().splitlines()
    assert first.startswith(f"{name}: absent (no folder {tmp_path / folder}); where to get it: https://")
    assert second.startswith("nothing was verified")


def test_what_is_no_fault_is_not_named(tree: Tree) -> None:
    """Links within the dataset and a linked root (large sets lie on another disk), and renderings beside the raws."""
    for name in ("IMG_0001.jpg", "IMG_0001.JPG", "IMG_0001.png", "Thumbs.db", "notes.txt", "dng"):
        (tree.data / ALPHA / name).write_bytes(b"\xff\xd8\xff")
    moved = tree.data / "kept.bin"
    tree.file(4).rename(moved)
    tree.file(4).symlink_to(moved)
    linked = tree.root.parent / "linked"
    linked.symlink_to(tree.root)
    assert verify([tree.manifest], linked, level="full").ok


def test_a_file_that_is_no_raw(tree: Tree) -> None:
    """Drive answers with a web page when its quota is used up."""
    for suffix in (".dng", ".npy"):
        tree.file(4).with_suffix(suffix).write_bytes(b"<html>Quota exceeded</html>")
        row = next(record for record in tree.manifest.records if record.path == frame(4))
        row = replace(row, path=frame(4).replace(".dng", suffix))
        (problem,), *_ = check_files(tree.manifest, tree.data, [row], level="metadata", workers=Workers())
        assert (problem.path, problem.field) == (row.path, "content")
        assert problem.found.startswith("is a web page (HTML or XML)")


def test_a_camera_may_have_several_names_in_any_case(tree: Tree) -> None:
    """Canon sells one body under three names."""
    retake(tree.file(4), model="DEMO ALPHA")
    retake(tree.file(5), model="Demo Kiss")
    card = json.loads(tree.csv.with_suffix(".json").read_text(encoding="utf-8"))
    card["cameras"]["DemoAlpha"]["models"].append("Demo Kiss")
    tree.csv.with_suffix(".json").write_text(json.dumps(card), encoding="utf-8")
    assert check(tree).ok


# --- wrong frames -------------------------------------------------------------------------------------------------

BOTH_KINDS = pytest.mark.parametrize("known", [True, False], ids=["exposures known", "exposures unknown"])


def forget_exposures(tree: Tree) -> None:
    """As in the published manifest for Canon: neither exposure times nor the references' ISO are known."""
    records = [
        replace(record, exposure_s=None, iso=None if record.role == "reference" else record.iso)
        for record in tree.manifest.records
    ]
    save_records(tree.csv, records)


@BOTH_KINDS
def test_a_reference_and_a_noisy_frame_swapped(tree: Tree, known: bool) -> None:
    reference, noisy = 1, 2
    if not known:
        forget_exposures(tree)
    swap(tree.file(reference), tree.file(noisy))
    report = check(tree)
    assert {frame(noisy)} <= {problem.path for problem in report.problems}
    assert all(problem.path.startswith(ALPHA) for problem in report.problems)
    if known:
        assert (frame(reference), "iso") in found(report)


@BOTH_KINDS
def test_shifted_numbering(tree: Tree, known: bool) -> None:
    """All frames of a scene numbered one higher, the last one put at the other end."""
    if not known:
        forget_exposures(tree)
    files = {number: tree.file(number).read_bytes() for number in range(1, 17)}
    for number, content in files.items():
        tree.file(number % 16 + 1).write_bytes(content)
    assert check(tree, "quick").ok, "names and number of files are right"
    report = check(tree)
    named = {problem.path for problem in report.problems}
    assert all(path.startswith(ALPHA) for path in named)
    assert named >= {frame(number) for number in range(1, 17) if number not in REFERENCES}
    assert all("shifted numbering" in problem.advice for problem in report.problems)


@pytest.mark.parametrize(
    ("number", "nominal", "measured", "passes"),
    [
        (5, 200, Fraction(220), True),
        (5, 200, Fraction(2201, 10), False),
        (5, 200, Fraction(1799, 10), False),
        (4, 100, Fraction(79), False),  # a third of a stop
    ],
)
def test_the_ratio_may_be_a_tenth_off(tree: Tree, number: int, nominal: int, measured: Fraction, passes: bool) -> None:
    forget_exposures(tree)
    scale_exposure(tree.file(number), Fraction(nominal) / measured)
    report = check(tree)
    if passes:
        assert report.ok
        return
    problem = only(report)
    assert (problem.path, problem.field) == (frame(number), "ratio")
    assert problem.expected == f"{nominal} to {frame(6)}"
    assert problem.found == f"{float(measured):.6g}"


# --- full ---------------------------------------------------------------------------------------------------------


def test_one_flipped_bit_is_found_by_its_hash_alone(tree: Tree) -> None:
    assert lock(tree.csv, tree.root).files_locked == 32
    assert check(tree, "full").datasets[0].files_hashed == 32
    first, *others = tree.manifest.records
    assert first.sha256 is not None
    nearly = first.sha256[:-1] + ("0" if first.sha256[-1] != "0" else "1")
    save_records(tree.csv, [replace(first, sha256=nearly), *others])
    assert only(check(tree, "full")).expected == nearly, "every digit counts"
    save_records(tree.csv, [first, *others])
    flip_compressed_byte(tree.file(4))
    assert check(tree, "metadata").ok
    problem = only(check(tree, "full"))
    assert (problem.path, problem.field) == (frame(4), "sha256")
    assert problem.expected != problem.found
    assert problem.found.startswith("sha256:")
    size = tree.file(4).stat().st_size
    with tree.file(4).open("ab") as file:
        file.write(b"\0")
    problem = only(check(tree, "quick"))
    assert (problem.field, problem.expected, problem.found) == ("size_bytes", f"{size} bytes", f"{size + 1} bytes")


def test_full_decodes_files_without_a_hash(tree: Tree) -> None:
    """A wrong picture size is only seen by decoding."""
    records = [replace(record, width=96, height=64) for record in tree.manifest.records]
    save_records(tree.csv, records)
    assert check(tree, "full").ok
    save_records(tree.csv, [replace(r, width=128) if r.path == frame(4) else r for r in records])
    assert check(tree, "metadata").ok
    problem = only(check(tree, "full"))
    assert (problem.path, problem.field, problem.expected, problem.found) == (frame(4), "width", "128", "96")


# --- what is asked ------------------------------------------------------------------------------------------------


def test_only_some_cameras(tree: Tree) -> None:
    shutil.rmtree(tree.data / "DemoBeta")
    report = check(tree, cameras=["DemoAlpha"])
    assert report.ok
    assert (report.datasets[0].files_listed, report.datasets[0].files_checked) == (16, 16)
    assert not check(tree, cameras=["DemoAlpha", "DemoBeta"]).ok
    assert found(check(tree, cameras=["DemoBeta"])) == [("DemoBeta/", "folder")]


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"cameras": ["Demoalpha"]}, ManifestError, "'Demoalpha'; known are DemoAlpha, DemoBeta"),
        ({"level": "thorough"}, ArgumentError, "'quick', 'metadata', 'full'; found 'thorough'"),
        ({"workers": 0}, ArgumentError, "workers must be 1 or more; found 0"),
    ],
)
def test_unknown_names(pristine: Tree, options: dict[str, object], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        verify([pristine.manifest], pristine.root, **{"level": "metadata", **options})  # type: ignore[arg-type]


def test_a_folder_of_manifests(tree: Tree) -> None:
    for suffix in (".csv", ".json"):
        shutil.copy(shipped_manifest("eld").path.with_suffix(suffix), tree.csv.parent)
    assert {manifest.name for manifest in find_manifests(tree.csv.parent)} == {"eld", "eld-demo"}
    assert verify(tree.csv.parent, tree.root).ok
