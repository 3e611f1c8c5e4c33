"""`eldata denoise`: take the noise out of photographs of your own.

Denoise raw files of Bayer or X-Trans cameras into DNGs with the camera's levels, colours and exposure. The noise is
known from --profile, else from the DNG's NoiseProfile, else from the photograph itself; the command says which.
network, which ships, takes Bayer alone; bm3d and anscombe-bm3d need the bm3d package, which its authors allow for
non-commercial use only. Denoised files that are in the folder are kept, so that interrupted work goes on.

    eldata denoise IMG_0004.ARW -o IMG_0004.dng
    eldata denoise night/*.NEF -o denoised --profile NikonD850
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eldata.base import console
from eldata.base.files import write_problem
from eldata.base.numbers import checked_number, counted
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, EldataError


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata denoise`."""
    parser.add_argument("files", metavar="RAW", nargs="+", help="raw files")
    parser.add_argument("-o", "--output", metavar="OUT", required=True, help="a file.dng, or a folder for several")
    text = "dct, bm3d, anscombe-bm3d, or a network of yours, as eldata predict takes it (default: %(default)s)"
    parser.add_argument("--method", metavar="M", default="network", help=text)
    parser.add_argument("--profile", metavar="P", help="profile of the camera's noise, by name or file")
    text = "take the profile though it is of another camera; what is printed says so"
    parser.add_argument("--profile-of-another-camera", action="store_true", help=text)
    parser.add_argument("--amplify", type=float, default=1.0, metavar="R", help="multiply the light (default: 1)")
    console.add_output(parser, "--preview", metavar="PNG", help="write the middle before and after (one file)")
    console.add_shared(parser, run, interrupted="finished files are kept, and the same command goes on")


def run(arguments: console.Arguments) -> int:
    """Denoise photographs into DNG files (`eldata denoise`)."""
    outputs = _name_outputs(arguments)
    from tqdm import tqdm

    from eldata.baselines.photographs import denoise_file, describe_work
    from eldata.noise.profile import CameraProfile

    profile = None if arguments.profile is None else CameraProfile.load(arguments.profile)
    options: dict[str, Any] = {
        "method": arguments.method, "ratio": checked_number("--amplify", arguments.amplify, above=0),
        "profile_of_another_camera": arguments.profile_of_another_camera,
    }  # fmt: skip
    missing = _leave_out_finished(outputs, describe_work(arguments.method, arguments.amplify, profile))
    if len(missing) < len(outputs):
        print(f"{len(outputs) - len(missing)} of {counted(len(outputs), 'photograph')} were denoised before")
    failed = False
    for source, out in tqdm(missing.items(), "denoising", unit="file", disable=None, leave=False):
        try:
            out.parent.mkdir(exist_ok=True)  # the folder for several
            made = denoise_file(source, out, profile, picture=arguments.preview, **options)
        except EldataError as error:
            if len(outputs) == 1:
                raise
            failed = True
            print(in_line(str(error)))
            continue
        print(in_line(f"{made.path}: noise {made.noise}"))
        for remark in made.remarks:
            print(in_line(f"  {remark}"))
    return console.PROBLEMS if failed else console.OK


def _name_outputs(arguments: console.Arguments) -> dict[Path, Path]:
    """Name each photograph's DNG; refuse to replace an existing file."""
    sources, out = [Path(name) for name in dict.fromkeys(arguments.files)], Path(arguments.output)
    if out.suffix.lower() == ".dng":
        if len(sources) > 1:
            raise ArgumentError(f"-o {out} is one file, and {len(sources)} photographs are given; name a folder")
        outputs = {sources[0]: out}
    elif out.suffix and not out.is_dir():
        raise ArgumentError(f"-o {out} does not end in .dng; if you mean a folder, make it first")
    else:
        outputs = {source: out / f"{source.stem}.dng" for source in sources}
    if len(set(outputs.values())) < len(outputs):
        raise ArgumentError("two photographs have the same name; denoise them into folders of their own")
    if arguments.preview and len(outputs) > 1:
        raise ArgumentError("--preview is for one photograph")
    for path in outputs.values() if out.suffix.lower() == ".dng" or out.exists() else [out]:
        problem = "is there already" if path == out and path.is_file() else write_problem(path)
        if problem is not None:
            raise ArgumentError(f"-o: cannot write {path}: {problem}")
    return outputs


def _leave_out_finished(outputs: dict[Path, Path], work: str) -> dict[Path, Path]:
    """Leave out what the same command made before; refuse to replace any other file."""
    from eldata.raw.container import read_container
    from eldata.raw.tiff import SOFTWARE

    missing = {source: out for source, out in outputs.items() if not out.exists()}
    for out in (out for source, out in outputs.items() if source not in missing):
        found = next((directory.texts.get(SOFTWARE) for directory in read_container(out).directories), None)
        if found != work:
            raise ArgumentError(f"-o: {out} is there, by {found or 'others'}, now {work}; give a new folder")
    return missing
