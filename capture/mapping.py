"""The mapping of files to shots as a JSON file, to be looked at, edited and passed back; metered times and apertures.

Exposure ratios are computed from ISO and time alone, so one aperture must hold for a scene. The plan may state it, EXIF
states it for each file; a lens without contacts states none, which is not a mistake.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import CaptureError
from capture.matching import Match, MatchRemark, can_be, describe_missing, match
from capture.observed import Observed, ObservedFrame, format_f_number, same_aperture
from eldata.base.fields import TextFile
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capture.matching import Slot
    from capture.plan import Plan

SCHEMA: Final = 1


def mapping_as_dict(plan: Plan, observed: Observed, match: Match) -> dict[str, Any]:
    """Return the mapping as plain JSON types: one line per shot, the files without one, and the remarks."""
    files = {slot: str(frame.path.absolute()) for slot, frame in match.frames.items()}
    unused = {frame.path: frame for frame in observed.frames} | {frame.path: None for frame in match.frames.values()}
    return {
        "schema": SCHEMA,
        "shots": [
            {
                "scene": scene,
                "number": shot.number,
                "shot": f"{shot.role}, {shot.settings}",
                "file": files.get((scene, shot.number)),
            }
            for scene, shot in plan.shots
        ],
        "unused": [
            {"file": str(frame.path.absolute()), "settings": frame.settings} for frame in unused.values() if frame
        ],
        "remarks": [f"{remark.kind}: {remark.text}" for remark in match.remarks],
    }


def load_mapping(path: Path | str, plan: Plan, observed: Observed) -> Match:
    """Read a mapping that was written before and, perhaps, edited.

    Only ``scene``, ``number`` and ``file`` of its ``shots`` are read. A shot without a file, or without a line, is
    missing.

    Raises
    ------
    CaptureError
        If the file is malformed, names a shot that the plan does not have, or a file that was not given, is used twice
        or has settings different from its shot's; the message says which.
    """
    top = TextFile(path, CaptureError).json()
    top.only(("schema", "shots", "unused", "remarks"))
    top.schema(SCHEMA, "capture")
    shots = {(scene, shot.number): shot for scene, shot in plan.shots}
    left = {frame.path.resolve(): frame for frame in observed.frames}
    frames: dict[Slot, ObservedFrame] = {}
    for fields in top.objects("shots"):
        fields.only(("scene", "number", "shot", "file"))
        slot = (fields.text("scene"), fields.whole("number", at_least=1))
        if slot not in shots or slot in frames:
            raise fields.wrong("number", f"a shot of the plan's {slot[0]}, each once", slot[1])
        if fields.value("file") is None:
            continue
        file = Path(fields.text("file")).resolve()
        if file not in left:
            raise fields.wrong("file", "one of the files given, each once, with the camera's ISO and time", str(file))
        frames[slot] = left.pop(file)
    remarks = [
        MatchRemark("extra", f"{frame.path.name}: {frame.settings}: left out by the mapping", path=frame.path)
        for frame in left.values()
    ]
    for (scene, number), shot in shots.items():
        frame = frames.get((scene, number))
        if frame is None:
            remarks.append(MatchRemark("missing", describe_missing(scene, shot), scene, number))
        elif not can_be(shot, frame):
            raise CaptureError(
                f"mapping, {scene} frame {number}: asks for {shot.settings}, and {frame.path} was taken at "
                f"{frame.settings}: its ratio would be wrong. Choose another file, or null to leave the frame out"
            )
    return Match(frames, tuple(remarks))


def explain_metering(plan: Plan, observed: Observed, matched: Match) -> Match:
    """Remark on scenes that lack most frames but have them at another metered time.

    Of the frames that this explains, nothing else is said. Only times of frames at the base ISO are tried: references
    are taken at the metered time.
    """
    used = {frame.path for frame in matched.frames.values()}
    left = replace(observed, frames=tuple(frame for frame in observed.frames if frame.path not in used), unusable=())
    settings = {
        plan.camera.round_to_nearest(frame.exposure_s) for frame in left.frames if frame.iso == plan.protocol.base_iso
    } - {None}
    remarks: list[MatchRemark] = []
    explained: set[Path] = set()
    for scene in plan.scenes:
        count = len(scene.shots)
        if 2 * sum(remark.scene == scene.name for remark in matched.missing) <= count:
            continue
        frames: Mapping[Slot, ObservedFrame] = {}
        dial = ""
        for setting in sorted(filter(None, settings), key=lambda setting: setting.nominal_s):
            with suppress(EldataError):  # some of its shots may be beyond the camera
                again = plan.only([scene.name]).remeter(scene.name, setting.nominal_s)
                tried = match(again, left).frames
                frames, dial = (tried, setting.dial) if len(tried) > len(frames) else (frames, dial)
        if 2 * len(frames) > count:
            text = (
                f"{scene.name}: planned for a metered time of {scene.metered_s} s; {len(frames)} of its {count} frames "
                f"are there if it was metered at {dial} s. If so: capture plan PLAN --remeter {scene.name}={dial}, and "
                "this again"
            )
            remarks.append(MatchRemark("metered", text, scene.name))
            explained |= {frame.path for frame in frames.values()}
    kinds = ("extra", "wrong-setting")
    remarks += [remark for remark in matched.remarks if remark.path not in explained or remark.kind not in kinds]
    return replace(matched, remarks=tuple(remarks))


def compare_apertures(plan: Plan, frames: Mapping[Slot, ObservedFrame]) -> tuple[MatchRemark, ...]:
    """Name the files with another aperture than their scene in the plan; a lens without contacts states none."""
    remarks = []
    for scene in plan.scenes:
        for shot in scene.shots:
            frame = frames.get((scene.name, shot.number))
            if frame is None or frame.f_number is None or scene.aperture is None:
                continue
            if not same_aperture(frame.f_number, scene.aperture):
                taken, planned = format_f_number(frame.f_number), format_f_number(scene.aperture)
                text = (
                    f"{frame.path.name} ({scene.name} frame {shot.number}): taken at {taken}, where the plan has "
                    f"{planned}: take the scene again; or, if all of it was taken so, correct the plan with "
                    f"capture plan --aperture {scene.name}={float(frame.f_number):.4g}"
                )
                remarks.append(MatchRemark("aperture", text, scene.name, shot.number, frame.path))
    return tuple(remarks)
