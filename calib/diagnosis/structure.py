"""Motion-dependent structure in what a fit leaves: parts of the additive basis fitted to it and tested on held-out logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.additive_basis import AdditiveBasis
from calib.diagnosis.fit import Fit
from calib.diagnosis.model import LogModel
from calib.diagnosis.rows import ResidualRows
from calib.diagnosis.tone import strongest
from calib.measurement.preprocessing import Measurement
from calib.regression.robust import huber

# Prior standard deviation for a white column of unit length: wide, but a bound where a part is badly conditioned.
SPREAD = 9.0
BARELY = 0.1  # of the longest column: what the fit has hardly seen must not grow large elsewhere
# Least gain in the fit, and on held-out logs. Recordings without structure (benchmarks/exam) reach at most 42 together with 6,
# most joints a third of that. Structure CLEARLY times as strong as LEAST in the fit needs proportionally less elsewhere: a
# swinging pedestal brought 90 and 7 (seed 26112821), what a neighbour's drag left 48 and 7. Of 1,700 joints without structure
# (seeds 26112921 to 26113001) none with more than 50 brought anything on a held-out recording.
LEAST, LEAST_APART, CLEARLY = 38.0, 8.0, 2.0
LEAST_SHARE = 0.02  # a long recording shows more than is worth reporting


@dataclass(frozen=True)
class Structure:
    """The part of the additive basis that holds best for one joint's residual.

    fitted    fall of chi2 on the logs of the fit, nuisance free to move
    held_out  fall of the loss on held-out logs, nothing fitted there; nan without such logs
    share     of the residual's variance, after whitening, that it explains
    rms       N m of that
    columns   number of hat functions of a turn, 0 of another part: noise alone brings about 1 with each
    """

    joint: str
    variables: str
    fitted: float
    held_out: float
    share: float
    rms: float
    columns: int = 0

    @property
    def enough(self) -> float:
        """What `fitted` must exceed.

        LEAST was chosen on parts of up to 24 columns. Without held-out logs to confirm a part, what noise brings in many hat
        functions is added; otherwise 18 of 96 clean arms had friction at one angle.
        """
        return LEAST + (self.columns if np.isnan(self.held_out) else 0)

    @property
    def real(self) -> bool:
        """Whether it exceeds what noise and wrong forms of ordinary effects bring, and is worth reporting."""
        enough = LEAST_APART * (LEAST / self.fitted if self.fitted > CLEARLY * LEAST else 1.0)
        return self.fitted > self.enough and not self.held_out < enough and self.share > LEAST_SHARE


def structures(best: Fit, apart: Sequence[Measurement]) -> list[Structure]:
    """Per joint, the strongest part."""
    kept = [LogModel(m, best.hypothesis) for m in apart]
    basis = AdditiveBasis([*best.models, *kept])
    left = best.solved.left()
    return [
        _strongest(_parts(best, left, kept, basis, j), best.hypothesis.arm.joint_names[j]) for j in range(best.hypothesis.arm.n)
    ]


def _strongest(parts: Sequence[Structure], joint: str) -> Structure:
    nothing = Structure(joint, "", 0.0, np.nan, 0.0, 0.0)  # of a joint that never moved
    return max(
        parts, key=lambda s: min(s.fitted / s.enough, np.nan_to_num(s.held_out / LEAST_APART, nan=np.inf)), default=nothing
    )


def _parts(best: Fit, rest: list[np.ndarray], kept: list[LogModel], basis: AdditiveBasis, j: int) -> list[Structure]:
    solved, count = best.solved, len(best.models)
    rows, noise = solved.rows, solved.noise
    other = ResidualRows(kept) if kept else None
    out: list[Structure] = []
    spots = basis.spots(j)  # one shape each, so one prior: an angle that was hardly passed says nothing
    for name, columns in (basis.groups(j) | spots).items():
        seen = rows.take(j, columns[:count])
        varied = seen.std(axis=0) > 1e-9 if len(seen) else np.zeros(0, dtype=bool)
        if not varied.any():
            continue
        middle = seen.mean(axis=0)[varied]
        white = rows.whiten(noise, j, seen[:, varied] - middle)
        size = np.sqrt((white**2).sum(axis=0))
        size = np.maximum(size, (1.0 if name in spots else BARELY) * size.max())
        white = white / size
        fitted, c, _ = solved.gain({j: white}, (SPREAD,) * white.shape[1], left=rest)
        held_out = np.nan
        if other is not None:
            left = other.whiten(noise, j, other.r[j] - other.predicted(j, solved.theta))
            part = other.whiten(noise, j, other.take(j, columns[count:])[:, varied] - middle) / size
            moved = solved.inverse @ solved.products(j, white @ c)
            held_out = huber(left) - huber(left - part @ c + other.whiten(noise, j, other.predicted(j, moved)))
        share = min(1.0, fitted / len(white))
        rms = float(noise.sigma[j] * np.sqrt(share))
        many = white.shape[1] if name in spots else 0
        out.append(Structure(best.hypothesis.arm.joint_names[j], name, fitted, held_out, share, rms, many))
    return out + _tones(best, kept, j)


def _tones(best: Fit, kept: list[LogModel], j: int) -> list[Structure]:
    """The strongest oscillation at one frequency, if every recording shows it."""
    models = [*best.models, *kept]
    left = [m.residual[:, j] - m.nuisance_torque(j, best.solved.theta) for m in models]
    found = strongest(models, left, j, len(best.models))
    if found is None or min(found.gains) < LEAST_APART:
        return []
    fitted, rms = sum(found.gains[: len(best.models)]), found.amplitude / np.sqrt(2)
    held_out = sum(found.gains[len(best.models) :]) if kept else np.nan
    share = min(1.0, (rms / best.solved.noise.sigma[j]) ** 2)
    return [Structure(best.hypothesis.arm.joint_names[j], f"tone:{found.frequency:.2f} Hz", fitted, held_out, share, rms)]
