"""A tethered session: the camera set, released and checked, shot by shot, and safe to cut off at any moment.

The order of steps makes it so. For each shot: intent into the journal; release and download into a folder of
that attempt alone; decode and compare with the plan; final name; done into the journal. After a crash, the next
session finds an intent without an end, and looks: at the final name, in the attempt's folder, on the camera's card.
Only if the frame is nowhere is it taken again.
"""

from __future__ import annotations

import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capture.capture_errors import CameraLostError, GphotoError, JournalError, TetherError
from capture.tether.choices import Choices, is_iso, is_time
from capture.tether.flats import NEVER_RIGHT, TRIES, clips_at_s, with_flats
from capture.tether.frames import Look, aside_path, check_free_space, downloaded, frame_name, look, taken_of
from capture.tether.gphoto import LOG, Gphoto, parse_taken
from capture.tether.journal import NAME as JOURNAL
from capture.tether.journal import Entry, Journal, fingerprint, place
from capture.tether.lock import locked
from capture.tether.pace import Pace
from capture.tether.preparing import prepare
from capture.tether.stages import stages_of
from capture.tether.verdicts import verdict_text
from eldata.base.files import sha256_of

if TYPE_CHECKING:
    from pathlib import Path

    from capture.check.measures import Verdict
    from capture.matching import Slot
    from capture.plan import Plan
    from capture.shots import Shot
    from capture.tether.levels import Levels
    from capture.tether.preparing import Ready
    from capture.tether.stages import Stage

INCOMING: Final = ".incoming"
ATTEMPTS: Final = 2
_READ_BACK: Final = 3
_READ_BACK_PAUSE_S: Final = 0.5

Say = Callable[[str], None]
Ask = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a session did.

    Attributes
    ----------
    files
        By shot.
    taken
        How many of them it took itself.
    seconds
        How long it took.
    verdicts
        Of the stages that were checked, by title.
    """

    files: dict[Slot, Path]
    taken: int
    seconds: float
    verdicts: dict[str, Verdict]


def run_session(
    plan: Plan,
    folder: Path,
    gphoto: Gphoto,
    *,
    whole: Plan | None = None,
    path: Path | str = "the plan",
    ask: Ask,
    say: Say,
    check: bool = True,
    save: Callable[[Plan], None] | None = None,
) -> Outcome:
    """Take every shot of a plan that the folder does not have yet.

    Parameters
    ----------
    plan
        What to take: a plan, or a part of it.
    folder
        Where frames and journal go; created if it does not exist.
    gphoto
        The program; with a port if several cameras are connected.
    whole
        The plan that ``plan`` is a part of: the journal belongs to it.
    path
        What to call the plan in messages.
    ask
        Shows what a stage needs, and returns when it is ready.
    say
        Shows a line of progress.
    check
        Whether each scene, and each set of calibration frames, is checked by its pixels when its last frame is here.
    save
        Writes the whole plan after its flats were planned again, since the first one showed that the surface clips at
        another time; without it flats are taken as they are planned.

    Raises
    ------
    TetherError
        If the session cannot start or go on. Frames already taken are kept; the same call resumes the session.
    """
    begun = time.monotonic()
    whole = plan if whole is None else whole
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TetherError(f"{folder}: cannot be made ({error.strerror})") from error
    with locked(folder) as lock:
        journal = Journal(folder / JOURNAL)
        journal.check(whole, path)
        gphoto = replace(gphoto, inherited=(lock.descriptor,), started=lock.note)
        session = _Session(plan, whole, folder, gphoto, journal, ask, say)
        session.check, session.save = check, save
        return Outcome(session.run(), session.taken, time.monotonic() - begun, session.verdicts)


class _Session:
    def __init__(
        self, plan: Plan, whole: Plan, folder: Path, gphoto: Gphoto, journal: Journal, ask: Ask, say: Say
    ) -> None:
        self.plan, self.whole, self.folder, self.gphoto = plan, whole, folder, gphoto
        self.journal, self.ask, self.say = journal, ask, say
        self.shots = {(scene, shot.number): shot for scene, shot in whole.shots}
        self.check = True
        self.save: Callable[[Plan], None] | None = None
        self.taken = 0
        self.state: dict[str, str] = {}
        self.levels: dict[Slot, Levels] = {}
        self.verdicts: dict[str, Verdict] = {}
        self.pace = Pace()

    def run(self) -> dict[Slot, Path]:
        """Take what is missing; return the files of the plan."""
        self.check_done()
        stages = stages_of(self.plan)
        if all(slot in self.have for stage in stages for slot, _ in stage.shots) and not self.journal.open_intents():
            self.sweep()
            return self.files()
        ready = prepare(self.plan, self.gphoto)
        self.gphoto = ready.gphoto
        for remark in ready.remarks:
            self.say(remark)
        self.journal.write_plan(self.whole)
        for intent in self.journal.open_intents():
            self.settle(intent)
        self.sweep()
        for planned in stages:
            here = sum(slot in self.have for slot, _ in planned.shots)
            if here == len(planned.shots):
                continue
            head = f"{planned.title}: {len(planned.shots)} frames"
            if here:
                head = f"{planned.title}: {here} of {len(planned.shots)} frames are here; go on"
            self.ask("\n".join([head, *(f"    {line}" for line in planned.prepare)]))
            stage, ready = self.expose_flats(planned, ready)
            for number, (slot, shot) in enumerate(stage.shots, 1):
                if slot in self.have:
                    continue
                self.pace.begin()
                self.take(slot, shot, ready.choices)
                self.pace.end(shot)
                self.say(
                    f"{stage.title}  {number}/{len(stage.shots)}  {shot.role}, {shot.settings}  "
                    f"{self.have[slot].details['file']}  {self.levels[slot]}{self.pace.text(self.plan, self.have)}"
                )
            self.check_stage(stage)
        self.sweep()
        return self.files()

    def check_stage(self, stage: Stage) -> None:
        """Check a stage whose frames are all here, and say what came out."""
        if not self.check:
            return
        files = self.files()
        sheet = self.folder / "checked" / f"{stage.title.replace(' ', '-')}.html"
        text, self.verdicts[stage.title] = verdict_text(
            self.plan, {slot: files[slot] for slot, _ in stage.shots}, sheet
        )
        self.say(text)

    def expose_flats(self, stage: Stage, ready: Ready) -> tuple[Stage, Ready]:
        """Take the first flat until its level is right, and plan the others by it; other stages stay as they are.

        A flat that is too bright or too dark is kept aside before the plan is written, so that a session that is cut
        off in between takes it again and comes to the same.
        """
        begun = any(slot in self.have for slot, _ in stage.shots[1:])
        if self.save is None or stage.shots[0][1].level is None or begun:
            return stage, ready
        for _ in range(TRIES):
            slot, shot = stage.shots[0]
            if slot not in self.have:
                self.take(slot, shot, ready.choices)
            path = self.files()[slot]
            seen = look(path, shot, self.plan.camera)
            if seen.levels is None:
                raise JournalError(f"{path}: {seen.problem}; move it away, then run this again")
            levels = seen.levels
            flat_clips_at_s = clips_at_s(self.plan, shot, levels)
            wanted = f"{float(100 * (shot.level or 0)):.0f} % is wanted"
            if flat_clips_at_s is None:
                self.say(f"{stage.title}  {shot.settings}: {levels}; {wanted}, which is near enough")
                return stage, ready
            plan, whole = (with_flats(one, flat_clips_at_s) for one in (self.plan, self.whole))
            place(path, aside_path(self.folder, slot, seen.observed, path.suffix))
            self.gone.add(slot)
            self.plan, self.whole = plan, whole
            self.shots = {(scene, one.number): one for scene, one in whole.shots}
            self.save(whole)
            self.journal.write_plan(whole)
            stage = next(one for one in stages_of(plan) if one.title == stage.title)
            self.say(
                f"{stage.title}  {shot.settings}: {levels}; {wanted}. The flats are planned again, for a surface that "
                f"clips at {float(flat_clips_at_s):g} s, from {stage.shots[0][1].setting.dial} s on"
            )
            ready = prepare(plan, self.gphoto)
        raise TetherError(NEVER_RIGHT)

    @property
    def have(self) -> dict[Slot, Entry]:
        """The frames that are here."""
        return {slot: entry for slot, entry in self.journal.done().items() if slot not in self.gone}

    def files(self) -> dict[Slot, Path]:
        """Return the files of the plan, in its order."""
        have = self.have
        slots = [(scene, shot.number) for scene, shot in self.plan.shots]
        return {slot: self.folder / str(have[slot].details["file"]) for slot in slots if slot in have}

    # --- before the first shot ----------------------------------------------------------------------------------------

    def check_done(self) -> None:
        """Check that the frames of the journal exist; those that were deleted are taken again."""
        self.gone: set[Slot] = set()
        begun_again = {intent.slot for intent in self.journal.open_intents()}
        for slot, entry in self.journal.done().items():
            path = self.folder / str(entry.details["file"])
            if slot in begun_again:
                self.gone.add(slot)  # it was deleted; what is there now, if anything, is that later attempt's
            elif not path.is_file():
                self.gone.add(slot)
                self.say(f"{path.name} is gone; it will be taken again")
            elif path.stat().st_size != entry.details["size_bytes"]:
                raise JournalError(
                    f"{path} has {path.stat().st_size} bytes, and had {entry.details['size_bytes']} when it was taken: "
                    "bring the original back, or delete it to have it taken again"
                )

    # --- one shot -----------------------------------------------------------------------------------------------------

    def take(self, slot: Slot, shot: Shot, choices: Choices) -> None:
        """Take one frame; set the camera again and try once more if it came out wrong."""
        target = self.folder / frame_name(slot, self.plan.camera)
        if target.exists():
            raise JournalError(f"{target} is there already, and this session did not take it: move it away")
        problem: str | None = None
        for _ in range(ATTEMPTS):
            sizes = [int(entry.details["size_bytes"]) for entry in self.journal.done().values()]
            check_free_space(self.folder, sizes)
            if problem is not None:
                self.say(f"{_title(slot)}: {problem}; once more")
            try:
                self.set(shot, choices)
                problem = self.release(slot, shot)
            except CameraLostError:
                raise
            except GphotoError as error:
                problem = str(error)
            if problem is None:
                self.taken += 1
                return
            self.state = {}
        raise TetherError(
            f"{_title(slot)} ({shot.settings}) failed {ATTEMPTS} times: {problem}. Look at the "
            "camera: mode dial on M, ISO and exposure automatics off, image format raw, drive single; then run the "
            "same command again, it goes on with this frame"
        )

    def set(self, shot: Shot, choices: Choices) -> None:
        """Set ISO and time if they differ from the camera's now, and read them back."""
        wanted = choices.values(shot)
        if self.state == wanted:
            return
        self.state = {}
        self.gphoto.set(wanted)
        said = ""
        for reading in range(_READ_BACK):
            if reading:
                time.sleep(_READ_BACK_PAUSE_S)  # some bodies step through their times one by one
            now = self.gphoto.settings(tuple(wanted))
            iso, shutter = now[choices.iso_name].current, now[choices.shutter_name].current
            if (is_iso(iso, shot.iso) or iso == wanted[choices.iso_name]) and (
                shutter == wanted[choices.shutter_name] or is_time(shutter, shot.setting)
            ):
                self.state = wanted
                return
            said = f"ISO {iso}, {shutter}"
        raise GphotoError(f"the camera shows {said} after it was set to {shot.settings}")

    def release(self, slot: Slot, shot: Shot) -> str | None:
        """Release, and bring the frame home; return what is wrong with it, or ``None``."""
        token = f"{slot[0]}_{slot[1]:04d}.{secrets.token_hex(6)}"
        folder = self.folder / INCOMING / token
        folder.mkdir(parents=True)
        intent = self.journal.write(Entry("intent", slot, fingerprint(self.whole, shot), token))
        failure: GphotoError | None = None
        try:
            self.gphoto.capture(folder, shot.setting.true_s)
        except GphotoError as error:
            failure = error
        found = self.bring_home(intent, shot, card=not isinstance(failure, CameraLostError))
        if found is not None and found.problem is None:
            return None
        if isinstance(failure, CameraLostError):
            raise failure  # the intent stays open: the frame may be on the card
        if found is None:
            problem = str(failure) if failure is not None else "gphoto2 ended well and downloaded nothing"
            self.journal.end(intent, "failed", reason=problem)
            shutil.rmtree(folder, ignore_errors=True)
            return problem
        return found.problem

    def bring_home(self, intent: Entry, shot: Shot, *, card: bool = True) -> Look | None:
        """Find an attempt's frame in its folder, or on the card if the download failed; ``None`` if it is nowhere.

        A frame gets its final name and a ``done``; a wrong one is kept aside, and gets a ``wrong``.
        """
        folder = self.folder / INCOMING / intent.token
        seen = downloaded(folder, shot, self.plan.camera)
        if seen is None or seen.observed is None:
            if not card:
                return None
            seen = self.from_card(folder, shot) or seen
        if seen is None:
            return None
        twin = self.twin(seen.path)
        if seen.problem is None and twin is not None:
            seen = replace(seen, problem=f"the camera sent the frame of {twin} once more")
        if seen.problem is None:
            self.finish(intent, seen)
        else:
            aside = aside_path(self.folder, intent.slot, seen.observed, seen.path.suffix)
            place(seen.path, aside)
            self.journal.end(intent, "wrong", file=aside.name, reason=seen.problem, exif=seen.exif)
        shutil.rmtree(folder, ignore_errors=True)
        return seen

    def twin(self, path: Path) -> str | None:
        """Return the name of an earlier frame with the very same content."""
        digest = sha256_of(path)
        same = (entry for entry in self.have.values() if entry.details["sha256"] == digest)
        return next((str(entry.details["file"]) for entry in same), None)

    def finish(self, intent: Entry, seen: Look) -> None:
        """Give a frame its final name, and write it down."""
        if seen.levels is not None:
            self.levels[intent.slot] = seen.levels
        target = self.folder / frame_name(intent.slot, self.plan.camera)
        digest, size = sha256_of(seen.path), seen.path.stat().st_size
        if seen.path != target:
            place(seen.path, target)
        self.journal.end(intent, "done", file=target.name, size_bytes=size, sha256=digest, exif=seen.exif)
        self.gone.discard(intent.slot)

    def from_card(self, folder: Path, shot: Shot) -> Look | None:
        """Download the frame from the camera's card, where a broken download left it; ``None`` if it is not there.

        It must be where gphoto2 said that it was; or be the newest on the card, and have been taken after the last
        frame that is here, by the camera's own clock.
        """
        log = folder / LOG
        said = parse_taken(log.read_text("utf-8", "replace")) if log.is_file() else ()
        try:
            card = self.gphoto.card()
        except CameraLostError:
            raise
        except GphotoError:
            return None  # many bodies do not show their card in remote mode
        extension = self.plan.camera.raw_extension.lower()
        raws = [path for path in card if path.suffix.lower() == extension]
        named = [path for path in raws if path in said]
        for path in named or raws[-1:]:
            inside = folder / "card"
            shutil.rmtree(inside, ignore_errors=True)
            inside.mkdir(parents=True)
            try:
                self.gphoto.fetch(path, inside)
            except CameraLostError:
                raise
            except GphotoError:
                continue
            seen = downloaded(inside, shot, self.plan.camera)
            if seen is not None and seen.problem is None and (named or self.is_new(seen)):
                self.say(f"the download had failed; {path.name} was fetched from the camera's card")
                return seen
        return None

    def is_new(self, seen: Look) -> bool:
        """Return whether a frame was taken after the last one that is here."""
        times = [taken_of(entry.details.get("exif", {})) for entry in self.journal.entries]
        known = [one for one in times if one is not None]
        taken = None if seen.observed is None else seen.observed.taken
        return taken is not None and bool(known) and taken > max(known)

    # --- after a crash ------------------------------------------------------------------------------------------------

    def settle(self, intent: Entry) -> None:
        """Find out what became of a shot that was begun but not ended."""
        slot = intent.slot
        shot = self.shots.get(slot)
        if shot is None or fingerprint(self.whole, shot) != intent.shot:
            self.journal.end(intent, "failed", reason="the plan now asks for another shot")
            return
        target = self.folder / frame_name(slot, self.plan.camera)
        before = self.journal.done().get(slot)
        if target.is_file() and (before is None or slot in self.gone):
            seen = look(target, shot, self.plan.camera)
            if seen.problem is not None:
                raise JournalError(f"{target}: {seen.problem}; move it away, then run this again")
            self.finish(intent, seen)
            found: Look | None = seen
        else:
            found = self.bring_home(intent, shot)
        if found is None:
            reason = "the last session was cut off, and the frame is neither here nor on the card"
            self.journal.end(intent, "failed", reason=reason)
            self.say(f"{_title(slot)}: {reason}; it will be taken again")
        elif found.problem is not None:
            self.say(f"{_title(slot)}: {found.problem}; it will be taken again")
        else:
            self.taken += 1
            self.say(f"{target.name} had been taken when the last session was cut off")

    def sweep(self) -> None:
        """Remove what ended attempts left in the folder for downloads."""
        shutil.rmtree(self.folder / INCOMING, ignore_errors=True)


def _title(slot: Slot) -> str:
    return f"{slot[0]} frame {slot[1]}"
