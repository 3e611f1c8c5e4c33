"""What gphoto2 prints and what is made of it; and the real program, as far as it goes without a camera.

The lists of settings are those of real cameras, as their owners reported them to the gphoto project.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.camera import CameraDescription
from capture.cli import main
from capture.observed import observe_one
from capture.plan import make_plan
from capture.protocol import CaptureProtocol
from capture.shots import Shot
from capture.shutter import Shutter
from capture.tether import CameraLostError, Gphoto, GphotoError, TetherError
from capture.tether.choices import choose, format_problem, is_time, iso_choice, seconds_of, time_choice
from capture.tether.frames import look
from capture.tether.gphoto import Setting, explained, parse_cameras, parse_card, parse_settings, parse_taken
from capture.tether.preparing import model_problem
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, SENSOR
from tests.raw.crw import write_crw
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Sequence

REAL_CR3 = Path(__file__).parents[1] / "raw" / "real" / "canon-eos-r6.cr3"
DETECTED = """\
Model                          Port            
----------------------------------------------------------
Nikon DSC D90 (PTP mode)       usb:003,010     
Mass Storage Camera            disk:/media/my card
USB PTP Class Camera           ptpip:192.168.1.1
"""  # noqa: W291 # as printed

NIKON = """
0.0001s 0.0002s 0.0003s 0.0004s 0.0005s 0.0006s 0.0008s 0.0010s 0.0012s 0.0015s 0.0020s 0.0025s 0.0031s 0.0040s 0.0050s
0.0062s 0.0080s 0.0100s 0.0125s 0.0166s 0.0200s 0.0250s 0.0333s 0.0400s 0.0500s 0.0666s 0.0769s 0.1000s 0.1250s 0.1666s
0.2000s 0.2500s 0.3333s 0.4000s 0.5000s 0.6250s 0.7692s 1.0000s 1.3000s 1.6000s 2.0000s 2.5000s 3.0000s 4.0000s 5.0000s
6.0000s 8.0000s 10.0000s 13.0000s 15.0000s 20.0000s 25.0000s 30.0000s Bulb
""".split()  # noqa: SIM905 # read as a list of the camera
FUJI = """
1/32000 1/25000 1/20000 1/16000 1/13000 1/10000 1/8000 1/6400 1/5000 1/4000 1/3200 1/2500 1/2000 1/1600 1/1250 1/1000
1/800 1/640 1/500 1/400 1/320 1/250 1/200 1/160 1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 1/10 1/8 1/6
1/5 1/4 1/3 0.4s 1/2 0.6s 0.8s 1s 1.3s 1.6s 2s 2.5s 3s 4s 5s 6s 8s 10s 13s 15s 20s 25s 30s 40s 50s 60s 2m 4m 8m 15m
""".split()  # noqa: SIM905
CANON = ["bulb", *reversed(Shutter.between("1/8000", "30", Fraction(1, 3)).dials)]
HALVES = [*Shutter.between("1/8000", "30", Fraction(1, 2)).dials, "Bulb"]
THIRDS = Shutter.between("1/32000", "60", Fraction(1, 3))


def shots_of(dials: Sequence[str], iso: int = 100) -> list[Shot]:
    times = {time.dial: time for time in THIRDS.times}
    return [Shot(n, "reference", iso, times[dial].nominal_s, times[dial]) for n, dial in enumerate(dials, 1)]


def camera_of(fastest: str, slowest: str) -> CameraDescription:
    shutter = Shutter.between(fastest, slowest, Fraction(1, 3))
    return CameraDescription("Any", ("Any 1",), ".ARW", (100, 200), 100, shutter)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1/60", Fraction(1, 60)),
        ("300/10", Fraction(30)),
        ("0.3", Fraction(3, 10)),
        ("0,0166s", Fraction(166, 10000)),
        ("1/1.3", Fraction(10, 13)),
        ('2.5"', Fraction(5, 2)),
        ("15 s", Fraction(15)),
        ("2m", Fraction(120)),
        ("Bulb", None),
        ("bulb", None),
        ("Time", None),
        ("Auto", None),
        ("x 200", None),
        ("1/0", None),
        ("Unknown value 0004", None),
        ("", None),
    ],
)
def test_a_choice_is_read_exactly(text: str, seconds: Fraction | None) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize(
    ("choices", "fastest"), [(CANON, "1/8000"), (FUJI, "1/32000"), (NIKON, "1/3200")], ids=["canon", "fuji", "nikon"]
)
def test_every_time_of_a_maker_is_found_once(choices: list[str], fastest: str) -> None:
    camera = camera_of(fastest, "30")
    found = choose(
        camera, shots_of(camera.shutter.dials), Setting("iso", "100", ("100",)), Setting("s", "1", tuple(choices))
    )
    assert list(found.times) == list(camera.shutter.dials)
    assert len(set(found.times.values())) == len(camera.shutter.dials)
    order = [choices.index(text) for text in found.times.values()]
    assert order == sorted(order, reverse=choices is CANON)


def test_a_time_that_could_be_two_is_refused() -> None:
    camera = camera_of("1/8000", "30")
    with pytest.raises(TetherError, match=r"1/8000 s \(it shows 0.0001s for this and for 1/6400 s\)"):
        choose(camera, shots_of(["1/8000"]), Setting("iso", "100", ("100",)), Setting("s", "1", tuple(NIKON)))
    with pytest.raises(TetherError, match=r"it shows 0\.0002s"):
        time_choice(camera.shutter.times[2], NIKON, camera.shutter.times)  # 1/5000, and 1/4000 cut to four decimals


def test_names_of_one_time() -> None:
    named = {time.dial: time for time in THIRDS.times}
    for text, dial in (("3s", "3.2"), ("1/3", "0.3"), ("0.7692s", "0.8"), ("1/13000", "1/12800"), ("0.0166s", "1/60")):
        assert is_time(text, named[dial])
    for text, dial in (("3s", "2.5"), ("1/50", "1/60"), ("0.0125s", "1/60"), ("Bulb", "30")):
        assert not is_time(text, named[dial])


def test_a_camera_set_to_half_stops_is_refused_even_where_names_agree() -> None:
    camera = camera_of("1/8000", "30")
    with pytest.raises(TetherError, match=r"offers steps of about 0\.5\d stop: set its exposure steps"):
        choose(camera, shots_of(["1/20"]), Setting("iso", "100", ("100",)), Setting("s", "1", tuple(HALVES)))
    half = CameraDescription("Any", ("A",), ".ARW", (100,), 100, Shutter.between("1/8000", "30", Fraction(1, 2)))
    time = half.named(Fraction(1, 20))
    assert time is not None
    shots = [Shot(1, "reference", 100, time.nominal_s, time)]
    assert choose(half, shots, Setting("iso", "1", ("100",)), Setting("s", "1", tuple(HALVES))).times == {
        "1/20": "1/20"
    }
    with pytest.raises(TetherError, match=r"offers steps of about 0\.3"):
        choose(half, shots, Setting("iso", "1", ("100",)), Setting("s", "1", tuple(CANON)))


def test_iso_is_taken_without_additions() -> None:
    choices = ["ISO Auto", "100 Multi Frame Noise Reduction", "Lo 0.3", "ISO 100", "200"]
    assert iso_choice(100, choices) == "ISO 100"
    assert iso_choice(200, choices) == "200"
    with pytest.raises(TetherError, match="ISO 400"):
        iso_choice(400, choices)


@pytest.mark.parametrize("text", ["RAW", "NEF (Raw)", "cRAW", "Unknown value 000d", "RAW Lossless", "RAF"])
def test_raw_formats(text: str) -> None:
    assert format_problem(Setting("imageformat", text)) is None


@pytest.mark.parametrize("text", ["Large Fine JPEG", "JPEG Fine", "Standard", "Extra Fine", "Fine"])
def test_compressed_formats(text: str) -> None:
    problem = format_problem(Setting("imagequality", text, ("Fine", "RAW", "RAW+JPEG (Fine)", "NEF (Raw)")))
    assert problem == f"the camera's imagequality is {text!r}: set it to RAW or NEF (Raw) in its menu"


@pytest.mark.parametrize("text", ["RAW + Large Fine JPEG", "NEF+Basic", "RAW+JPEG (X.Fine)", "NEF+Fine"])
def test_raw_with_a_jpeg_beside_it(text: str) -> None:
    assert "alone. With a JPEG beside it" in (format_problem(Setting("imageformat", text)) or "")


def test_models() -> None:
    assert model_problem("ILCE-7SM2", ("ILCE-7SM2",)) is None
    assert model_problem("D90", ("NIKON D90",)) is None
    assert model_problem("canon eos 5d mark iv", ("Canon EOS 5D Mark IV",)) is None
    assert "calls itself D9" in (model_problem("D9", ("NIKON D90", "NIKON D900")) or "")


def test_cameras_settings_and_files_are_parsed() -> None:
    assert [(model, port) for port, model in parse_cameras(DETECTED).items()] == [
        ("Nikon DSC D90 (PTP mode)", "usb:003,010"),
        ("USB PTP Class Camera", "ptpip:192.168.1.1"),
    ]
    assert parse_cameras("") == {}
    text = "Label: Shutter Speed\nReadonly: 0\nType: RADIO\nCurrent: 1/30\nChoice: 0 30\nChoice: 1 1/30\nEND\n"
    other = "Label: Battery Level     \nReadonly: 1\nType: TEXT\nCurrent: 100%\nEND\n"
    assert parse_settings(text + other) == [("1/30", ("30", "1/30"), False), ("100%", (), True)]
    assert parse_settings("Label: Copyright\nReadonly: 0\nType: TEXT\nCurrent: \nEND\n") == [("", (), False)]
    said = "New file is in location /capt0000.arw on the camera       \nSaving file as frame.arw\n"
    assert parse_taken(said) == (PurePosixPath("/capt0000.arw"),)
    listed = (
        "FILENAME='/DCIM/B.NEF' PERMS=rd FILESIZE=    3 FILETYPE=image/x-raw\nFILENAME='/A.NEF' FILESIZE=7 FILEMTIME=9"
    )
    assert [str(path) for path in parse_card(listed)] == ["/DCIM/B.NEF", "/A.NEF"]


@pytest.mark.parametrize(
    ("output", "words", "lost"),
    [
        ("*** Error (-53: 'Could not claim the USB device') ***", "another program holds the camera", True),
        ("Could not detect any camera\n*** Error (-105: 'Unknown model') ***", "no camera answers", True),
        ("*** Error (-52: 'Could not find the requested device on the USB port') ***", "no camera answers", True),
        (
            "PTP Device Busy\nERROR: Could not capture.\n*** Error (-110: 'I/O in progress') ***",
            "camera is busy",
            False,
        ),
        ("*** Error (-10: 'Timeout reading from or writing to the port') ***", "connection broke", False),
        ("This camera can not capture.\n*** Error (-6: 'Unsupported operation') ***", "cannot release", False),
        ("Canon EOS Capture failed: Perhaps no focus?\nERROR: Could not capture.", "manual focus", False),
        ("Choice 1/3 not found within list of choices.", "mode dial to M", False),
        ("Some new text", "failed and said: Some new text", False),
        ("", "said: nothing", False),
    ],
)
def test_errors_say_what_to_do(output: str, words: str, lost: bool) -> None:
    error = explained("--capture-image", output)
    assert words in str(error)
    assert isinstance(error, CameraLostError) is lost


def test_a_frame_of_another_camera_or_none_at_all(tmp_path: Path) -> None:
    shot = shots_of(["1/60"])[0]
    mosaic = np.full((SENSOR.height, SENSOR.width), 900, dtype=np.uint16)
    write_dng(tmp_path / "frame.DNG", mosaic, SENSOR, Exposure(Fraction(100), Fraction(1, 60)))
    assert look(tmp_path / "frame.DNG", shot, CAMERA).problem is None
    assert "taken by Nocturne 1; the plan is for Any 1" in (
        look(tmp_path / "frame.DNG", shot, camera_of_dng()).problem or ""
    )
    write_dng(tmp_path / "none.DNG", mosaic, SENSOR, Exposure(Fraction(100)))
    assert "states no exposure time" in (look(tmp_path / "none.DNG", shot, CAMERA).problem or "")


def test_canons_containers_say_which_camera_took_them(tmp_path: Path) -> None:
    """Regression: a CR3 and a CRW named none, and a session took them for another camera's."""
    write_crw(tmp_path / "a.CRW", (66, 0, 160, *[0] * 19, 192))
    observed = observe_one(tmp_path / "a.CRW")
    assert (observed.model, observed.iso, observed.exposure_s) == ("Canon EOS D60", Fraction(100), Fraction(1, 64))
    observed = observe_one(REAL_CR3)
    assert (observed.model, observed.iso, observed.exposure_s) == ("Canon EOS R6", Fraction(25600), Fraction(1, 100))
    assert observed.taken is not None


def camera_of_dng() -> CameraDescription:
    return CameraDescription("Any", ("Any 1",), ".dng", (100,), 100, CAMERA.shutter)


# --- the real program -------------------------------------------------------------------------------------------------

REAL = shutil.which("gphoto2")
needs_gphoto2 = pytest.mark.skipif(REAL is None, reason="the program gphoto2 is not installed: apt install gphoto2")


@pytest.fixture(autouse=True)
def _at_home_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program remembers the last port in ~/.gphoto."""
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.fixture
def real(tmp_path: Path) -> Gphoto:
    """The real program with its own camera of no hardware: a folder, which it lists and downloads as a memory card."""
    card = tmp_path / "my card" / "DCIM" / "100MSDCF"
    card.mkdir(parents=True)
    (card / "DSC00001.ARW").write_bytes(bytes(range(256)) * 5000)
    (card / "DSC00002.JPG").write_bytes(b"jpeg")
    found = Gphoto.find("gphoto2", timeout_s=PATIENCE_S)
    return Gphoto(found.program, f"disk:{tmp_path / 'my card'}", PATIENCE_S)


@pytest.mark.tether
@needs_gphoto2
def test_the_real_program_lists_and_downloads(real: Gphoto, tmp_path: Path) -> None:
    files = real.card()
    assert list(map(str, files)) == ["/DCIM/100MSDCF/DSC00001.ARW", "/DCIM/100MSDCF/DSC00002.JPG"]
    folder = tmp_path / "100% new"
    folder.mkdir()
    for _ in range(2):  # the second time over the first
        real.fetch(files[0], folder)
    assert [path.name for path in folder.iterdir()] == ["frame.ARW"]
    assert (folder / "frame.ARW").stat().st_size == 1280000
    with pytest.raises(GphotoError, match="File not found"):
        real.fetch(PurePosixPath("/DCIM/100MSDCF/DSC00009.ARW"), folder)


@pytest.mark.tether
@needs_gphoto2
def test_the_real_program_refuses_what_a_card_cannot_do(real: Gphoto, tmp_path: Path) -> None:
    assert real.detect() == {}  # a card is not a camera
    for call in (real.setting_names, lambda: real.settings(["iso"]), lambda: real.set({"iso": "100"})):
        with pytest.raises(GphotoError, match="does not take this setting"):
            call()
    with pytest.raises(GphotoError, match="gphoto2 cannot release") as caught:
        real.capture(tmp_path, 0.1)
    assert "For debugging messages" not in str(caught.value)
    assert "This camera can not capture" in (tmp_path / "gphoto2.log").read_text()


@pytest.mark.tether
@needs_gphoto2
@pytest.mark.parametrize("port", ["", "usb:001,099", "bogus", "ptpip:127.0.0.1"])
def test_the_real_program_without_a_camera(port: str) -> None:
    gphoto = Gphoto.find("gphoto2", timeout_s=PATIENCE_S)
    if gphoto.detect():
        pytest.skip("a camera is connected")
    gphoto = replace(gphoto, port=port)
    with pytest.raises(CameraLostError if port != "ptpip:127.0.0.1" else GphotoError):
        gphoto.settings(["iso"])


@pytest.mark.tether
@needs_gphoto2
def test_a_session_with_the_real_program_and_no_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if Gphoto.find("gphoto2", timeout_s=PATIENCE_S).detect():
        pytest.skip("a camera is connected")
    plan = make_plan(CAMERA, CaptureProtocol(), {"scene-1": Fraction(1)})
    plan.save(tmp_path / "plan.json")
    assert main(["run", str(tmp_path / "plan.json"), "-o", str(tmp_path / "shots"), "--yes"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("capture run: no camera was found: plug the cable in")
    assert error.count("\n") == 1
