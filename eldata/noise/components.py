"""The noise model of the ELD paper, whole and in plain numpy: read this first.

A raw value is ``D = K I + N`` (equation 1), with I photoelectrons and the gain K in DN per photoelectron. The noise is
``N = K N_p + N_read + N_r + N_q`` (equation 8). Each function below draws one of these terms in DN, and
:func:`expose` adds them up. :class:`~eldata.noise.NoiseModel` draws from the same distributions with two engines that
are much faster (``_kernels.py`` and ``on_device.py``); tests hold both against these functions.

======  =====================================================  =========================
``P``   photon shot noise, Gaussian with the signal's variance  K
``P*``  photon shot noise, Poisson                              K
``G``   read noise, Gaussian                                    sigma_gauss_dn
``G*``  read noise, Tukey lambda                                tukey_lambda, sigma_tl_dn
``B``   colour bias: the read noise's mean per channel          colour_bias_dn
``R``   row noise, one Gaussian draw per mosaic row             sigma_row_dn
``U``   quantisation noise, uniform over one step of the DN     quantisation_step_dn
``D``   real dark frames instead of G, B, R and U               gain of their ISO
======  =====================================================  =========================

A new component is a function here with its entry in :data:`COMPONENTS`, a step in ``_kernels.py`` and one in
``on_device.py``.

Source: K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", TPAMI
2021, section 3.1 and table 2. D, real frames instead of a model of the dark, is the idea of Y. Zhang, H. Qin, X. Wang
and H. Li, "Rethinking Noise Synthesis and Modeling in Raw Denoising", ICCV 2021 (SFRN).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.levels import packed_forms, packed_layouts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters

Values: TypeAlias = "NDArray[np.float64]"
Component: TypeAlias = Callable[[Values, "NoiseParameters", np.random.Generator], Values]


def draw_gaussian_shot(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """P: ``K N_p`` with ``N_p ~ N(0, sqrt(I))``, the normal limit of equation 2."""
    normal = generator.standard_normal(photoelectrons.shape)
    return parameters.gain_dn_per_e * np.sqrt(photoelectrons) * normal


def draw_poisson_shot(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """P*: ``K N_p`` with ``I + N_p ~ Poisson(I)`` (equation 2)."""
    return parameters.gain_dn_per_e * (generator.poisson(photoelectrons) - photoelectrons)


def draw_gaussian_read(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """G: ``N_read ~ N(0, sigma_G)``, the usual assumption (section 3.1.2)."""
    return parameters.sigma_gauss_dn * generator.standard_normal(photoelectrons.shape)


def draw_tukey_lambda(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """G*: ``N_read ~ TL(lambda; 0, sigma_TL)`` (equation 4).

    Its quantile is ``(u^lambda - (1 - u)^lambda) / lambda`` of a uniform u, and ``ln(u / (1 - u))`` at lambda = 0.
    """
    u, shape = generator.uniform(np.nextafter(0, 1), 1, photoelectrons.shape), parameters.tukey_lambda
    quantile = (u**shape - (1 - u) ** shape) / shape if shape else np.log(u / (1 - u))
    return np.asarray(parameters.sigma_tl_dn * quantile)


def draw_colour_bias(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """B: ``mu_c``, the mean of the read noise in each colour (equation 5)."""
    del generator
    bias = np.array(parameters.channel_bias_dn(len(photoelectrons)))
    return np.broadcast_to(bias[:, None, None], photoelectrons.shape)


def draw_row_noise(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """R: ``N_r ~ N(0, sigma_r)`` (equation 6), one draw for each row of the mosaic; packed R and G1 share one."""
    rows = mosaic_rows(*photoelectrons.shape)
    draws = generator.standard_normal(rows.max(initial=-1) + 1)
    return np.asarray(parameters.sigma_row_dn * draws[rows])


def draw_quantisation(photoelectrons: Values, parameters: NoiseParameters, generator: np.random.Generator) -> Values:
    """U: ``N_q ~ U(-q/2, q/2)`` with the quantisation step q (equation 7)."""
    half = parameters.quantisation_step_dn / 2
    return generator.uniform(-half, half, photoelectrons.shape)


COMPONENTS: dict[str, Component] = {
    "P": draw_gaussian_shot,
    "P*": draw_poisson_shot,
    "G": draw_gaussian_read,
    "G*": draw_tukey_lambda,
    "B": draw_colour_bias,
    "R": draw_row_noise,
    "U": draw_quantisation,
}
"""The components that have a formula, by their names in the paper's table 2."""

PAPER_MODELS = ("G", "G+P", "G+P*", "G*+P*", "G*+P*+B", "G*+P*+B+R", "G*+P*+B+R+U")
"""The models that the ELD paper compares, in the order of its rows, from the simplest to the full one."""

_SOURCES = {
    "P": "photon shot noise",
    "P*": "photon shot noise",
    "G": "read noise",
    "G*": "read noise",
    "B": "colour bias",
    "R": "row noise",
    "U": "rounding",
    "D": "dark frame",
}


def expose(
    clean: NDArray[Any],
    spec: str,
    parameters: NoiseParameters,
    *,
    ratio: float,
    range_dn: float,
    generator: np.random.Generator,
) -> Values:
    """Add the noise of a spec to one clean image (C, h, w), packed and normalised: the definition of the model.

    Sections 3.1 and 3.2.3 of the paper: ``I = y range / (ratio K)``, ``D = K I + N``, and the result is
    ``D ratio / range``, as bright as the clean image. Values below 0 count as no light.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.noise import NoiseParameters
    >>> from eldata.noise.components import expose
    >>> parameters, generator = NoiseParameters(1.5, 0.0, 2.5, 5.0, 0.5), np.random.default_rng(0)
    >>> dark = np.zeros((4, 256, 256))
    >>> noisy = expose(dark, "P*+G", parameters, ratio=100.0, range_dn=15871.0, generator=generator)
    >>> round(noisy.std() * 15871.0 / 100.0)
    5
    """
    gain = parameters.gain_dn_per_e
    photoelectrons = np.maximum(clean, 0).astype(np.float64) * (range_dn / (ratio * gain))
    noise_dn = sum(COMPONENTS[name](photoelectrons, parameters, generator) for name in parse_components(spec))
    return np.asarray((gain * photoelectrons + noise_dn) * (ratio / range_dn))


def parse_components(spec: str) -> tuple[str, ...]:
    """Read a spec such as ``"P*+G*+B+R+U"``: names joined by ``+``, in any order; ``P^*`` means ``P*``.

    Returns
    -------
    tuple
        The names in the order of the table above.

    Raises
    ------
    ArgumentError
        If it is not a text, a name is unknown or repeated, there are none, or two models of one noise source are asked
        for.

    Examples
    --------
    >>> from eldata.noise import parse_components
    >>> parse_components("G*+P^*+R")
    ('P*', 'G*', 'R')
    """
    if not isinstance(spec, str):
        raise ArgumentError(f"a noise model's spec is a text such as 'P*+G*+B+R+U'; found {spec!r:.100}")
    names = [name.strip().replace("^", "") for name in spec.split("+")]
    by_source: dict[str, str] = {}
    for name in names:
        if name not in _SOURCES:
            raise ArgumentError(f"noise model {spec!r}: {name!r} is not a component; known are {', '.join(_SOURCES)}")
        if names.count(name) > 1:
            raise ArgumentError(f"noise model {spec!r}: {name} is in it twice; each source adds its noise once")
        source = _SOURCES[name]
        other = by_source.setdefault(source, name)
        if other != name:
            raise ArgumentError(
                f"noise model {spec!r}: {' and '.join(sorted((name, other)))} are two models of the same {source}; "
                "take one"
            )
        if "D" in names and not name.startswith(("P", "D")):
            raise ArgumentError(
                f"noise model {spec!r}: the frames of D have their own {source}, and {name} would add it again; take "
                "one, as in 'P*+D'"
            )
    return tuple(name for name in _SOURCES if name in names)


# --- the rows of the mosaic under packed data ------------------------------------------------------------------------


@cache
def packed_rows(channels: int) -> tuple[NDArray[np.int64], int]:
    """Describe which mosaic rows lie under packed data with 4 (Bayer), 9 (X-Trans), 16 (quad) or 36 (nona) channels.

    Bayer: R and G1 share a row, B and G2 the other; quad and nona: the same, of each row of the blocks. Which come
    first depends on the phase and changes no statistic.

    Returns
    -------
    table, period
        (C, s, s) int64 and the mosaic rows per s packed rows: packed entry (c, y, x) lies in mosaic row
        ``(y // s) * period + table[c, y % s, x % s]``.

    Raises
    ------
    ArgumentError
        For any other number of channels.
    """
    sites = packed_layouts().get(channels)
    if sites is None:
        raise ArgumentError(f"packed data has {packed_forms()} channels; found {channels}")
    table = np.empty((channels, sites.sub, sites.sub), dtype=np.int64)
    for row, _, channel, y, x in sites.table:
        table[channel, y, x] = row
    return table, sites.period


def mosaic_rows(channels: int, height: int, width: int) -> NDArray[np.int64]:
    """Return the mosaic row of each entry of packed data (C, h, w)."""
    table, period = packed_rows(channels)
    sub = table.shape[1]
    y, x = np.arange(height)[:, None], np.arange(width)
    return np.asarray((y // sub) * period + table[:, y % sub, x % sub])
