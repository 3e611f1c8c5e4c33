"""What the audit of bias frames finds, measured: ``python -m tests.calibration.audit_study``, by hand.

The main rows of what it prints stand in docs/calibration.md, "What the audit finds": each fault in several sizes, how
far it puts each figure off, what the audit makes of it, and how often the figures that are given lie within their
errors. With ``--clean N`` it counts what the audit says of N random cameras without a fault. A quick form of both is in
test_bias_audit.py.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.audit.bias_checks import bias_findings
from eldata.calibration.audit.bias_sums import BiasAudit, BiasSeen, code_step, missing_codes
from eldata.calibration.core.findings import given, with_accepted
from tests.calibration import draws
from tests.calibration.chain import calibrated, figures_of
from tests.calibration.faults import EVERY, NONE, Planted
from tests.calibration.simulation import XTRANS, Body, Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core.findings import Finding, GivenFigure

CAMERA = Camera(shape=(512, 768), shading=1.0)
FRAMES = 9


@dataclass(frozen=True)
class Audited:
    """One camera's bias frames through the estimators and the audit: each figure before it, with it, and in truth."""

    findings: tuple[Finding, ...]
    before: dict[str, GivenFigure]
    after: dict[str, GivenFigure | None]
    truth: dict[str, float]

    @property
    def effects(self) -> dict[str, str]:
        return {one.check: one.effect for one in self.findings}

    def covered(self, name: str) -> bool | None:
        """Whether a figure lies within 1.96 errors of the truth; ``None`` if it is withheld."""
        figure = self.after[name]
        return None if figure is None else abs(figure.value - self.truth[name]) <= 1.96 * figure.error


def audited(
    camera: Camera, frames: Sequence[NDArray[np.uint16]], *, accept: Sequence[str] = (), knows_gain: bool = True
) -> Audited:
    found = calibrated(camera, frames)
    audit = BiasAudit(found.fixed)
    for frame in frames:
        audit.add(frame)
    pattern = found.fixed.pattern
    step, gaps = code_step(frames[0], pattern), missing_codes(frames[0], pattern)
    gain = camera.gain if knows_gain else None
    seen = BiasSeen(audit.statistics(), found.bias, found.rows, found.read, step, gaps, gain_dn_per_e=gain)
    findings = with_accepted(bias_findings(seen), accept)
    before, after, truth = {}, {}, {}
    for name, (figure, value, error, true, scale) in figures_of(found, camera).items():
        before[name] = given((), figure, value, error, scale)
        after[name] = given(findings, figure, value, error, scale)
        truth[name] = true
    return Audited(findings, {name: one for name, one in before.items() if one is not None}, after, truth)


def planted(
    fault: Planted, seed: int, camera: Camera = CAMERA, frames: int = FRAMES, accept: Sequence[str] = ()
) -> Audited:
    body = Body(camera, np.random.default_rng(seed))
    return audited(camera, fault.bias_frames(body, frames), accept=accept)


def drawn_camera(generator: np.random.Generator) -> Camera:
    """A camera without a fault: any CFA, tails, noise and fixed pattern of the shipped profiles' ranges.

    One in five is quieter than any of these, down to noise that is lost in rounding.
    """
    xtrans = bool(generator.random() < 0.3)
    noise = draws.drawn_noise(generator, [100, 3200], 3 if xtrans else 4)[generator.integers(2)]
    quiet = float(np.exp(generator.uniform(np.log(0.1), np.log(0.6))))
    return Camera(
        shape=(390, 576) if xtrans else (384, 576),
        cfa=XTRANS if xtrans else draws.BAYER_PHASES[generator.integers(4)],
        gain=noise.gain_dn_per_e,
        tukey_lambda=noise.tukey_lambda,
        sigma_tl=quiet if generator.random() < 0.2 else noise.sigma_tl_dn,
        sigma_row=noise.sigma_row_dn,
        bias=noise.colour_bias_dn,
        black=2048.0,
        dsnu=float(generator.choice([0.0, 0.2, 0.6])),
        column_pattern=float(generator.choice([0.0, 0.3])),
        hot_share=float(generator.choice([0.0, 1e-4, 1e-3])),
        shading=float(generator.choice([0.0, 1.0, 5.0])),
    )


def clean(seed: int) -> tuple[Finding, ...]:
    """What is said of one of those, from 4 to 12 frames."""
    generator = np.random.default_rng(seed)
    camera = drawn_camera(generator)
    return audited(camera, Body(camera, generator).bias_frames(int(generator.choice([4, 5, 9, 12])))).findings


FIGURES: dict[str, tuple[str, ...]] = {"read noise": ("lambda", "sigma_TL", "sigma_G"), "row noise": ("sigma_row",)}
HEADER = ("fault", *(name for names in FIGURES.values() for name in names), *FIGURES, "what is said")


def off_by(name: str, runs: Sequence[Audited]) -> str:
    """The mean error of a figure, and the same in errors as they were stated before there was an audit."""
    off = float(np.mean([run.before[name].value - run.truth[name] for run in runs]))
    errors = off / float(np.mean([run.before[name].error for run in runs]))
    return (
        f"{off:+.4f} ({errors:+.0f})"
        if name == "lambda"
        else f"{100 * off / runs[0].truth[name]:+.1f} % ({errors:+.0f})"
    )


def fate(names: Sequence[str], runs: Sequence[Audited]) -> str:
    """How many cameras' figures are withheld, and how often the errors of those that are given reach the truth."""
    given_in = [run for run in runs if run.after[names[0]] is not None]
    if not given_in:
        return "withheld"
    covered = sorted({round(100 * float(np.mean([bool(run.covered(name)) for run in given_in]))) for name in names})
    held = f"{covered[0]} %" if len(covered) == 1 else f"{covered[0]} to {covered[-1]} %"
    return held if len(given_in) == len(runs) else f"withheld {len(runs) - len(given_in)}/{len(runs)}, else {held}"


def row_of_table(fault: Planted, repeats: int, camera: Camera) -> tuple[str, ...]:
    runs = [planted(fault, seed, camera) for seed in range(repeats)]
    said = Counter(check for run in runs for check in {one.check: None for one in run.findings})
    named = ", ".join(what if count >= repeats else f"{what} {count}/{repeats}" for what, count in said.items())
    off = [off_by(name, runs) for names in FIGURES.values() for name in names]
    return fault.name, *off, *(fate(names, runs) for names in FIGURES.values()), named or "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what the audit of bias frames finds.")
    parser.add_argument("--repeats", type=int, default=20, help="cameras for each fault and size")
    parser.add_argument("--clean", type=int, default=0, help="count alarms on so many cameras without a fault instead")
    arguments = parser.parse_args()
    if arguments.clean:
        said = Counter(one.check for seed in range(arguments.clean) for one in clean(seed))
        alarms = ", ".join(f"{name} of {count}" for name, count in said.items()) or "nothing is said"
        print(f"{arguments.clean} cameras without a fault: {alarms}")
        return
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for fault in (NONE, *EVERY):
        print(f"| {' | '.join(row_of_table(fault, arguments.repeats, CAMERA))} |", flush=True)


if __name__ == "__main__":
    main()
