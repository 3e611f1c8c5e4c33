"""Importing the camera parameters that the ELD authors published (``<camera>_params.npy``), once they are JSON.

Such a file is a pickle, and unpickling runs code of the file's choice: that is left to whoever trusts it. docs/noise.md
has the three lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.errors import ProfileError
from eldata.noise.profile import CameraProfile, LogLogFit, ProfileRow

if TYPE_CHECKING:
    from pathlib import Path

_FIELDS = (
    "the fields of published parameters, Kmin, Kmax, G_shape, color_bias and Profile-1 with slope, bias and sigma of "
    "G_scale, g_scale and R_scale"
)
SOURCE = "ELD repository (Vandermode/ELD, MIT licence), commit 53d5408, camera_params"


def read_published(path: Path | str) -> dict[str, Any]:
    """Return the dictionary of a published parameter file that was turned into JSON.

    Raises
    ------
    ProfileError
        If the file cannot be read, or is not such JSON.
    """
    advice = "numpy turns a *_params.npy into the JSON that is read here: docs/noise.md has the three lines"
    return dict(TextFile(path, ProfileError, advice=advice).json().data)


def profiles_from_published(camera: str, data: dict[str, Any], source: str = SOURCE) -> tuple[CameraProfile, ...]:
    """Return one profile per published calibration (``Profile-1``, ``Profile-2``).

    The published rows name neither ISO nor gain. They run two per ISO, and every camera's Kmax is 64 Kmin, which is
    ISO 100 to 6400 in proportion; so row i is taken as ISO 100 * 2^(i // 2) with K in proportion. The profile's notes
    say so.

    Raises
    ------
    ProfileError
        If a key is missing or of the wrong kind.
    """
    try:
        low, high = float(data["Kmin"]), float(data["Kmax"])
        names = sorted(key for key in data if key.startswith("Profile-"))
        if len(data["G_shape"]) != len(data["color_bias"]) or not data["G_shape"] or not names:
            raise ProfileError(f"{camera}: expected as many G_shape as color_bias rows, and a Profile-1")
        rows = []
        for index, (shape, bias) in enumerate(zip(data["G_shape"], data["color_bias"], strict=True)):
            red, green, blue, second_green = map(float, bias)
            iso, gain = 100.0 * 2 ** (index // 2), low * 2 ** (index // 2)
            rows.append(ProfileRow(float(shape), (red, green, blue, second_green), iso, gain))
        profiles = []
        for name in names:
            scales = (data[name][key] for key in ("G_scale", "g_scale", "R_scale"))
            lines = [LogLogFit(*(float(line[part]) for part in ("slope", "bias", "sigma"))) for line in scales]
            profiles.append(
                CameraProfile(
                    camera=camera,
                    source=f"{source}, {name}",
                    gain_range_dn_per_e=(low, high),
                    tukey_lambda_fit=lines[0],
                    gauss_fit=lines[1],
                    row_fit=lines[2],
                    rows=tuple(rows),
                    iso_range=(100.0, 6400.0),
                    notes=(
                        "ISO and gain of the rows, and the ISO range, are inferred: the published file names neither.",
                        "Kmax / Kmin is 64 in every published file: ISO 100 to 6400 in proportion to the gain.",
                    ),
                )
            )
    except KeyError as error:
        raise ProfileError(f"{camera}: expected {_FIELDS}; {error.args[0]!r} is missing") from error
    except (TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise ProfileError(f"{camera}: expected {_FIELDS}, all numbers; found something else: {error}") from error
    return tuple(profiles)
