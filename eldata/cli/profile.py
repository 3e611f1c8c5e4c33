"""`eldata profile`: list, show or import noise profiles of cameras.

Camera profiles: list those that ship, show one, or make one of published parameters.

    eldata profile list
    eldata profile show SonyA7S2
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.tables import one_line, text_table, wrapped

if TYPE_CHECKING:
    from eldata.noise.profile import CameraProfile


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata profile` and its subcommands."""
    subcommands = parser.add_subparsers(title="commands", metavar="COMMAND")
    show = console.add_command(subcommands, "show", run_show.__doc__)
    show.add_argument("camera", metavar="CAMERA", help="name of a shipped profile, or path of a JSON file")
    console.add_shared(show, run_show, json=True)
    importing = console.add_command(subcommands, "import", run_import.__doc__)
    importing.add_argument("file", metavar="FILE", help="the parameters, JSON")
    console.add_output(importing, "-o", "--output", help="write the camera profile to FILE (JSON)", required=True)
    importing.add_argument("--camera", metavar="NAME", help="the camera's name (default: the file's, less _params)")
    text = "which of several calibrations in the file, such as Profile-2 (default: the only one)"
    importing.add_argument("--calibration", metavar="NAME", help=text)
    console.add_shared(importing, run_import)
    listing = console.add_command(subcommands, "list", run_list.__doc__)
    console.add_shared(listing, run_list, json=True)


def run_show(arguments: console.Arguments) -> int:
    """`eldata profile show`: show a profile.

    Show what a profile knows of its camera: its rows by ISO, and the lines of the noise over K.

        eldata profile show SonyA7S2
    """
    from eldata.noise.profile import CameraProfile

    profile = CameraProfile.load(arguments.camera)
    lines = [*_format_facts(profile), "", *_format_rows(profile)]
    console.show_and_write(arguments, lambda: "\n".join(lines), profile.as_dict)
    return console.OK


def _format_facts(profile: CameraProfile) -> list[str]:
    """Format the facts on a camera, a line each."""
    low, high = profile.gain_range_dn_per_e
    frames = sum(len(row.frame_bias_dn) for row in profile.rows)
    facts = [
        ("source", one_line(profile.source)),
        ("gain", f"{low:.4g} to {high:.4g} DN/e-"),
        ("ISO", "not known" if profile.iso_range is None else "{:g} to {:g}".format(*profile.iso_range)),
        *(("mode", f"{mode}, {'{:.4g} to {:.4g}'.format(*mode.gain_range_dn_per_e)} DN/e-") for mode in profile.modes),
        *(
            (name, f"{level:g} DN")
            for name, level in (("black", profile.black_level_dn), ("white", profile.white_level_dn))
            if level is not None
        ),
        *([("frames", f"colour biases of {frames} bias frames, of which a draw takes one")] if frames else []),
        *([("step", f"{step:g} DN, the quantisation step")] if (step := profile.quantisation_step_dn) != 1 else []),
        *(("accepted", f" {one_line(check)}, with a larger error") for check in profile.accepted),
        *(("note", one_line(note)) for note in profile.notes),
    ]
    lines = [line for name, text in facts for line in wrapped(f"  {name:<8}{text}", " " * 10)]
    return [one_line(profile.camera), *lines]


def _format_rows(profile: CameraProfile) -> list[str]:
    """Describe the figures at each ISO, and the lines over K."""

    def format_cell(value: float | None) -> str:
        return "-" if value is None else f"{value:.4g}"

    header = ("ISO", "K", "lambda", "sigma_TL", "sigma_G", "sigma_row", "bias R", "G1", "B", "G2")
    rows = []
    for row in profile.rows:
        scales = row.sigma_tl_dn, row.sigma_gauss_dn, row.sigma_row_dn
        figures = row.gain_dn_per_e, row.tukey_lambda, *scales, *row.colour_bias_dn
        rows.append(("-" if row.iso is None else f"{row.iso:g}", *map(format_cell, figures)))
    known = [place for place in range(len(header)) if any(row[place] != "-" for row in rows)]
    table = text_table([header[place] for place in known], [[row[place] for place in known] for row in rows], left=())
    lines = []
    for mode in profile.modes or (profile.mode_at(profile.gain_range_dn_per_e[0]),):
        for name, fit in (
            ("sigma_TL", mode.tukey_lambda_fit),
            ("sigma_G", mode.gauss_fit),
            ("sigma_row", mode.row_fit),
        ):
            where = f", {mode}" if profile.modes else ""
            lines.append(
                f"{name} has no line over K: it was measured at too few ISOs{where}"
                if fit is None
                else f"ln {name} = {fit.slope:.4g} ln K {'+-'[fit.intercept < 0]} {abs(fit.intercept):.4g}, residuals "
                f"{fit.sigma:.3g}{where}"
            )
    return [table, "", *lines, "in DN and DN/e-"]


def run_import(arguments: console.Arguments) -> int:
    """`eldata profile import`: make a profile of published parameters (JSON).

    Make a profile of parameters as the ELD authors publish them, turned into JSON: CAMERA_params.npy is a pickle, which
    is not read here; docs/noise.md has the three lines of numpy that turn it. The profile's notes say what is inferred.

        eldata profile import SonyA7S2_params.json -o sony.json
    """
    from pathlib import Path

    from eldata.base.visible import in_line
    from eldata.errors import ArgumentError
    from eldata.noise.published import profiles_from_published, read_published

    path = Path(arguments.file)
    camera = arguments.camera or path.stem.removesuffix("_params")
    data = read_published(path)
    profiles = profiles_from_published(camera, data, source=f"{path.name}, as the ELD authors publish such files")
    named = {profile.source.rpartition(", ")[2]: profile for profile in profiles}
    known = in_line(", ".join(named))
    if arguments.calibration is None and len(named) > 1:
        raise ArgumentError(
            f"{in_line(arguments.file)} holds {len(named)} calibrations; choose one with --calibration: {known}"
        )
    chosen = arguments.calibration or next(iter(named))
    if chosen not in named:
        raise ArgumentError(f"{in_line(arguments.file)} holds no calibration {chosen!r}; known are {known}")
    profile = named[chosen]
    profile.save(arguments.output)
    print(
        f"{in_line(camera)}: {len(profile.rows)} rows, {chosen}\n"
        f"profile: {arguments.output}; look at it with eldata profile show {shlex.quote(arguments.output)}"
    )
    return console.OK


def run_list(arguments: console.Arguments) -> int:
    """`eldata profile list`: list the profiles that ship.

    List shipped profiles.

        eldata profile list
    """
    from eldata.noise.profile import CameraProfile, shipped_profiles

    rows, listed = [], []
    for name in shipped_profiles():
        profile = CameraProfile.load(name)
        low, high = profile.gain_range_dn_per_e
        isos = "-" if profile.iso_range is None else "{:g} to {:g}".format(*profile.iso_range)
        rows.append((name, f"{low:.4g} to {high:.4g}", isos, str(len(profile.rows)), profile.source))
        facts = {field: getattr(profile, field) for field in ("camera", "gain_range_dn_per_e", "iso_range")}
        listed.append({"profile": name} | facts | {"rows": len(profile.rows), "source": profile.source})
    header = ("profile", "gain [DN/e-]", "ISO", "rows", "source")
    console.show_and_write(arguments, lambda: text_table(header, rows, left=(0, 4)), lambda: listed)
    return console.OK
