"""Files of camera profiles: JSON, read and checked; the profiles that ship."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from eldata.base.fields import Fields, TextFile, names_of
from eldata.errors import ProfileError, did_you_mean
from eldata.noise.gain_modes import OF_ONE_MODE, GainMode, LogLogFit, ProfileRow
from eldata.noise.parameters import shape_problem

if TYPE_CHECKING:
    from collections.abc import Collection

_SCHEMA = 1
_SCHEMA_WITH_MODES = 2
_FRAMES = "a list of four numbers (R, G1, B, G2) for each bias frame"
_MEAN_DN = 0.001  # by rounding of either
_FOLDER = Path(__file__).parent / "profiles"


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the shipped profiles.

    Examples
    --------
    >>> from eldata.noise import shipped_profiles
    >>> shipped_profiles()
    ('CanonEOS5D4', 'CanonEOS700D', 'CanonEOS70D', 'NikonD850', 'NikonD850-2', 'SonyA7S2', 'SonyA7S2-PMN')
    """
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.json")))


def profile_path(name: str | Path) -> Path:
    """Return the file of a shipped profile, by its name, or of any, by its path.

    Raises
    ------
    ProfileError
        If none is called so.
    """
    if not isinstance(name, str) or "/" in name or name.endswith(".json"):
        return Path(name)
    known = shipped_profiles()
    if name not in known:
        raise ProfileError(
            f"no camera profile is called {name!r}; known are {', '.join(known)}, or give the path of a .json "
            f"file{did_you_mean(name, known)}"
        )
    return _FOLDER / f"{name}.json"


def schema_of(modes: Collection[GainMode]) -> int:
    """Return the schema of a profile's file, the lowest that has room for it."""
    return _SCHEMA_WITH_MODES if modes else _SCHEMA


def read_profile(path: Path, known: Collection[str]) -> dict[str, Any]:
    """Return what a profile's file holds, as the arguments of :class:`~eldata.noise.profile.CameraProfile`.

    Raises
    ------
    ProfileError
        If it is malformed, or has a field that is not ``known``; the message names file, field, expected and found.
    """
    top = TextFile(path, ProfileError).json()
    schema = top.schema(_SCHEMA, also=(_SCHEMA_WITH_MODES,))
    has_modes = schema == _SCHEMA_WITH_MODES
    absent = OF_ONE_MODE if has_modes else ("modes",)
    top.only(("schema", *(name for name in known if name not in absent)))
    return {
        "camera": top.text("camera"),
        "source": top.text("source"),
        "gain_range_dn_per_e": _range(top, "gain_range_dn_per_e"),
        **(dict.fromkeys(OF_ONE_MODE) if has_modes else _lines(top)),
        "rows": tuple(map(_row, top.objects("rows", fewest=1, expected="a list of at least one row"))),
        "iso_range": top.optional("iso_range", partial(_range, top)),
        "black_level_dn": top.optional("black_level_dn", top.number),
        "white_level_dn": top.optional("white_level_dn", top.number),
        "notes": top.texts("notes", missing_ok=True, empty=True),
        "modes": tuple(map(_mode, top.objects("modes", fewest=2, expected="a list of two modes or more")))
        if has_modes
        else (),
        "accepted": top.texts("accepted", missing_ok=True, empty=True),
        "quantisation_step_dn": top.optional("quantisation_step_dn", top.number, 1.0, above=0),
    }


def _mode(mode: Fields) -> GainMode:
    mode.only(names_of(GainMode))
    return GainMode(
        _range(mode, "gain_range_dn_per_e"),
        **_lines(mode),
        iso_range=mode.optional("iso_range", partial(_range, mode)),
    )


def _lines(holder: Fields) -> dict[str, LogLogFit | None]:
    nothing = [name for name in OF_ONE_MODE if holder.data.get(name, holder) is None]
    return {name: None if name in nothing else _fit(holder.inside(name)) for name in OF_ONE_MODE}


def _range(top: Fields, name: str) -> tuple[float, float]:
    low, high = top.each(name, Fields.number, count=2, expected="two numbers")
    if not 0 < low <= high:
        raise top.wrong(name, "two positive numbers, the lower first", [low, high])
    return low, high


def _fit(fit: Fields) -> LogLogFit:
    fit.only(names_of(LogLogFit))
    return LogLogFit(fit.number("slope"), fit.number("intercept"), fit.number("sigma", at_least=0))


def _bias(holder: Fields, name: str) -> tuple[float, float, float, float]:
    red, green, blue, second_green = holder.each(name, Fields.number, count=4, expected="four numbers (R, G1, B, G2)")
    return red, green, blue, second_green


def _row(row: Fields) -> ProfileRow:
    row.only(names_of(ProfileRow))
    bias, frames = _bias(row, "colour_bias_dn"), row.each("frame_bias_dn", _bias, missing_ok=True, expected=_FRAMES)
    means = [fmean(of_channel) for of_channel in zip(*frames, strict=True)] or bias
    if any(abs(mean - stated) > _MEAN_DN for mean, stated in zip(means, bias, strict=True)):
        raise row.wrong("frame_bias_dn", f"frames whose mean is colour_bias_dn to {_MEAN_DN} DN", [*map(list, frames)])
    shape = row.number("tukey_lambda")
    problem = shape_problem(shape)
    if problem is not None:
        raise row.wrong("tukey_lambda", f"a number {problem}", shape)
    return ProfileRow(
        tukey_lambda=shape,
        colour_bias_dn=bias,
        frame_bias_dn=frames,
        **{name: row.optional(name, row.number, above=0) for name in ("iso", "gain_dn_per_e")},
        **{
            name: row.optional(name, row.number, at_least=0)
            for name in ("sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")
        },
        **{name: row.optional(name, row.number) for name in ("r_squared_tl", "r_squared_gauss")},
    )
