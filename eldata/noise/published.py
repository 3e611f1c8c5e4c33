"""Importing the camera parameters that the ELD authors published (``<camera>_params.npy``).

Such a file is a pickle, and unpickling runs code of the file's choice. It is not unpickled: see
:mod:`eldata.noise.plain_pickle`.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from eldata.base.files import file_problem
from eldata.base.npy import read_npy_header
from eldata.errors import ProfileError
from eldata.noise.gain_modes import LogLogFit
from eldata.noise.plain_pickle import MOST_BYTES, plain_content
from eldata.noise.profile import CameraProfile, ProfileRow

SOURCE = "ELD repository (Vandermode/ELD, MIT licence), commit 53d5408, camera_params"


def read_published(path: Path | str) -> dict[str, Any]:
    """Return the plain content of a published parameter file: dictionaries, lists, numbers.

    Raises
    ------
    ProfileError
        If the file is not such a pickle, or asks for anything but numpy arrays and plain types; none of it is run then.
    """
    path = Path(path)
    problem = file_problem(path)
    if problem is not None:
        raise ProfileError(f"{path}: {problem}")
    try:
        with path.open("rb") as file:
            stream = io.BytesIO(file.read(2 * MOST_BYTES))
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        header = read_npy_header(stream)
        if header.descr.lstrip("|") != "O" or header.shape:
            raise ProfileError(f"{path}: expected a dictionary, found an array of {header.values} {header.shape}")
        plain = plain_content(stream.read())
    except ValueError as error:
        raise ProfileError(f"{path}: is not a published parameter file ({error}); none of it was run") from error
    if not isinstance(plain, dict):
        raise ProfileError(f"{path}: expected a dictionary, found {type(plain).__name__}")
    return plain


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
        shapes, biases = list(data["G_shape"]), list(data["color_bias"])
        names = sorted(key for key in data if key.startswith("Profile-"))
        if len(shapes) != len(biases) or not shapes or not names:
            raise ProfileError(f"{camera}: expected as many G_shape as color_bias rows, and a Profile-1")
        rows = tuple(
            ProfileRow(
                tukey_lambda=float(shape),
                colour_bias_dn=(float(bias[0]), float(bias[1]), float(bias[2]), float(bias[3])),
                iso=100.0 * 2 ** (index // 2),
                gain_dn_per_e=low * 2 ** (index // 2),
            )
            for index, (shape, bias) in enumerate(zip(shapes, biases, strict=True))
        )
        profiles = []
        for name in names:
            fits = {
                key: LogLogFit(float(fit["slope"]), float(fit["bias"]), float(fit["sigma"]))
                for key, fit in data[name].items()
            }
            profiles.append(
                CameraProfile(
                    camera=camera,
                    source=f"{source}, {name}",
                    gain_range_dn_per_e=(low, high),
                    tukey_lambda_fit=fits["G_scale"],
                    gauss_fit=fits["g_scale"],
                    row_fit=fits["R_scale"],
                    rows=rows,
                    iso_range=(100.0, 6400.0),
                    notes=(
                        "ISO and gain of the rows, and the ISO range, are inferred: the published file names neither.",
                        "Kmax / Kmin is 64 in every published file: ISO 100 to 6400 in proportion to the gain.",
                    ),
                )
            )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise ProfileError(f"{camera}: is not a published parameter dictionary ({error!r})") from error
    return tuple(profiles)
