"""The components of the noise model, by the names of the paper's ablation table.

======  =====================================================  =========================
``P``   photon shot noise, Gaussian with the signal's variance  K
``P*``  photon shot noise, Poisson                              K
``G``   read noise, Gaussian                                    sigma_gauss_dn
``G*``  read noise, Tukey lambda                                tukey_lambda, sigma_tl_dn
``B``   colour bias: the read noise's mean per channel          colour_bias_dn
``R``   row noise, one Gaussian draw per mosaic row             sigma_row_dn
``U``   quantisation noise, uniform over one step of the DN     quantisation_step_dn
``D``   real dark frames, in place of G, B, R and U             gain of their ISO
======  =====================================================  =========================

Source: K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", TPAMI
2021, section 3.1 and table 2. D, real frames in place of all that a model says of the dark, is the idea of
Y. Zhang, H. Qin, X. Wang and H. Li, "Rethinking Noise Synthesis and Modeling in Raw Denoising", ICCV 2021 (SFRN).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from eldata.errors import ArgumentError

Shot = Literal["none", "gaussian", "poisson"]
Read = Literal["none", "gaussian", "tukey-lambda"]

PAPER_MODELS = ("G", "G+P", "G+P*", "G*+P*", "G*+P*+B", "G*+P*+B+R", "G*+P*+B+R+U")
"""The models that the ELD paper compares, in the order of its rows, from the simplest to the full one."""

_NAMES = ("P", "P*", "G", "G*", "B", "R", "U", "D")
_SHOTS: dict[str, Shot] = {"P": "gaussian", "P*": "poisson"}
_READS: dict[str, Read] = {"G": "gaussian", "G*": "tukey-lambda"}
# The others, each there or not, in the order in which a spec has them.
_FLAGS = {"B": "colour_bias", "R": "row", "U": "quantisation", "D": "dark"}
_EXCLUSIVE = (("P", "P*", "photon shot noise"), ("G", "G*", "read noise"))
# What dark frames have in them.
_IN_DARK = {"G": "read noise", "G*": "read noise", "B": "colour bias", "R": "row noise", "U": "rounding"}


@dataclass(frozen=True, slots=True)
class Components:
    """Which components a model has."""

    shot: Shot
    read: Read
    colour_bias: bool
    row: bool
    quantisation: bool
    dark: bool = False

    @property
    def spec(self) -> str:
        """The components as a spec that :func:`parse_components` reads back."""
        names = [name for name, shot in _SHOTS.items() if shot == self.shot]
        names += [name for name, read in _READS.items() if read == self.read]
        return "+".join(names + [name for name, field in _FLAGS.items() if getattr(self, field)])


def parse_components(spec: str) -> Components:
    """Read a spec such as ``"P*+G*+B+R+U"``: names joined by ``+``, in any order; ``P^*`` means ``P*``.

    Raises
    ------
    ArgumentError
        If it is not a text, a name is unknown or repeated, there are none, or two models of one noise source are asked
        for.

    Examples
    --------
    >>> from eldata.noise import parse_components
    >>> components = parse_components("P*+G*+B+R+U")
    >>> components.shot, components.read, components.row
    ('poisson', 'tukey-lambda', True)
    """
    if not isinstance(spec, str):
        raise ArgumentError(f"a noise model's spec is a text such as 'P*+G*+B+R+U'; found {spec!r:.100}")
    names = [name.strip().replace("^", "") for name in spec.split("+")]
    for name in names:
        if name not in _NAMES:
            raise ArgumentError(f"noise model {spec!r}: {name!r} is not a component; known are {', '.join(_NAMES)}")
    for name in set(names):
        if names.count(name) > 1:
            raise ArgumentError(f"noise model {spec!r}: {name} is in it twice; each source adds its noise once")
    for first, second, source in _EXCLUSIVE:
        if first in names and second in names:
            raise ArgumentError(
                f"noise model {spec!r}: {first} and {second} are two models of the same {source}; take one"
            )
    for name, source in _IN_DARK.items() if "D" in names else ():
        if name in names:
            raise ArgumentError(
                f"noise model {spec!r}: the frames of D have their own {source}, and {name} would add it again; take "
                "one, as in 'P*+D'"
            )
    return Components(
        shot=next((shot for name, shot in _SHOTS.items() if name in names), "none"),
        read=next((read for name, read in _READS.items() if name in names), "none"),
        **{field: name in names for name, field in _FLAGS.items()},
    )
