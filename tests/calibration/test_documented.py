"""docs/calibration.md says what to do about each remark and each check: from the sources, so that none is forgotten."""

from __future__ import annotations

import re
from pathlib import Path

from eldata.base.fields import shipped_toml
from eldata.calibration.iso_results import CHECKS, SENTENCES

ROOT = Path(__file__).parents[2]
DOCS = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
CODE = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "eldata/calibration").rglob("*.py")))
# In frames.py, below the sentences.
OF_FRAMES = [
    "… has the same pixels as … and was left out",
    "… were left out: their levels over black are …",
]  # frames.py
REMARKS = [*OF_FRAMES, *(re.sub(r"\{[^}]*\}", "…", text) for text in shipped_toml(SENTENCES)["remarks"].values())]


def phrases() -> list[list[str]]:
    """What the first column of the table of remarks quotes; "…" in it stands for anything."""
    table = DOCS[DOCS.index("### What a remark says") : DOCS.index("### What a plot shows")]
    cells = [line.split(" | ")[0] for line in table.splitlines() if line.startswith('| "')]
    return [quoted.split(" … ") for cell in cells for quoted in re.findall(r'"([^"]+)"', cell)]


def test_each_remark_is_documented_and_each_documented_one_is_made() -> None:
    assert len(REMARKS) > 20
    for remark in REMARKS:
        assert any(all(part in remark for part in phrase) for phrase in phrases()), remark
    for phrase in phrases():
        assert any(all(part in text for part in phrase) for text in REMARKS), phrase


def test_each_sentence_is_said() -> None:
    """By its name, whole, or with the last word chosen; and none is asked for that there is not."""
    names = {f"{kind}.{name}" for kind, texts in shipped_toml(SENTENCES).items() for name in texts}
    asked = set(re.findall(r'fill_sentence\(\s*"([a-z.-]+)"', CODE))
    chosen = {"findings.even-steps", "findings.uneven-steps", "no-profile.k-withheld", "no-profile.no-k"}
    assert asked | chosen == names


def test_each_check_is_documented() -> None:
    assert sorted(check.name for check in CHECKS) == sorted(re.findall(r"^\| `([^`]+)` \|", DOCS, re.MULTILINE))
