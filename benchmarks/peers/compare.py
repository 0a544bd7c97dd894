"""Torque errors of this tool, its peers and a baseline on unseen motions, identified from logs of exactly known arms.

The metric needs no agreement on parameters. It is the torque of each tool's model on unseen motions against the noise-free
truth, as a share of the torque's own standard deviation, separately for sliding joints and near reversals. Five arms, motions
and noises. The table also has what the log can determine at all (`floor`).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy import stats

from benchmarks.kept import FOLDER, Kept
from benchmarks.known_truth import fitting_motion, fourier_motion, recorded_on_mock, varied, without_offsets
from benchmarks.peers.floor import FREE, KNOWN, OWN, floors
from benchmarks.peers.ridge import ridge
from benchmarks.peers.running import ONE_STEP, PYTHON, peers_on, random_states
from benchmarks.results import digest
from calib.excitation.session import joined
from calib.identification.identify import identify
from calib.identification.least_squares import ordinary
from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import prepare
from sim.arm import load_arm
from sim.prediction import predict
from sim.slip import SLIP_WIDTH, slip_direction
from sim.trajectory import Trajectory

MOTION = 10.0  # s
# rad/s above which a joint slides. Reversals leave out the fraction of a milliradian in which the truth's dry friction changes
# sign, because the peers' sign(dq) cannot represent it
SLIDING, TURNED = 0.05, 0.99
OURS, RIDGE, NOMINAL = "calib identify", "ridge around the nominal arm", "nominal arm"
BARS = {(10.0, OURS): "not behind any", (60.0, OURS): "<= 0.65, half of any other"}
# what the logs and the peers' results depend on, and what ours depend on
LOGS = ("benchmarks.known_truth", "benchmarks/peers")
MEASURES = ("benchmarks.peers.compare", *LOGS)


def run(minutes: float = 30.0, seeds: int = 5, lengths: Sequence[float] = (10.0, 60.0)) -> list[dict[str, Any]]:
    """Run cases for `minutes`; return rows over all tried so far, with a row that says so if the peers are not installed."""
    end = time.monotonic() + 60 * minutes
    ours = Kept(FOLDER / "peers.jsonl", " ".join(map(digest, MEASURES)))
    peers = Kept(FOLDER / "peers.jsonl", " ".join([*map(digest, LOGS), str(PYTHON.is_file())]))
    every = {s: [f"{s:g} {seed}" for seed in range(seeds)] for s in lengths}
    for kept, work in ((ours, our_case), (peers, peer_case)):  # ours first: the peers take minutes per log
        for seconds, names in every.items():
            for seed, name in enumerate(names):
                if name not in kept.found and time.monotonic() < end:
                    kept.keep(name, work(Case(seed, seconds)))
    found = {
        s: [_joined(ours.found[name], peers.found[name]) for name in names if name in ours.found and name in peers.found]
        for s, names in every.items()
    }
    rows = [row for seconds, cases in found.items() if cases for row in accuracy(seconds, cases, seeds)]
    if not rows:
        return [_row("logs", "none so far", note="give more --minutes; the next run goes on")]
    rows += times(found[lengths[0]])
    if not PYTHON.is_file():
        rows.append(_row("peers", "not installed", note="`make peers` installs figaroh and mujoco.sysid into .venv-peers"))
    return rows


def accuracy(seconds: float, cases: list[dict[str, Any]], seeds: int) -> list[dict[str, Any]]:
    """One row per tool and kind of sample: mean over the seeds so far, with its 95 % interval."""
    rows = []
    for kind in ("sliding", "reversals"):
        for tool in cases[0]["errors"]:
            x = np.array([case["errors"][tool][kind] for case in cases])
            ours = np.array([case["errors"][OURS][kind] for case in cases])
            floor = np.array([case["errors"][KNOWN][kind] for case in cases])
            worse = "" if tool in (OURS, NOMINAL, KNOWN, OWN, FREE) else f"ours is lower in {np.sum(ours < x)} of {len(x)}"
            if tool not in (NOMINAL, KNOWN):
                beyond = np.sqrt(max(np.mean(x**2) - np.mean(floor**2), 0.0))
                worse += f"{'; ' * bool(worse)}beside the floor {beyond:.2f}"
            if len(x) < seeds:
                worse = f"{len(x)} of {seeds} seeds so far{'; ' * bool(worse)}{worse}"
            rows.append(_row(f"{seconds:g} s log, {kind}: {tool}", interval(x), "%", BARS.get((seconds, tool), ""), worse))
    return rows


def interval(x: np.ndarray) -> str:
    """Mean of x (N,) with its 95 % interval (Student); without an interval if N is 1."""
    if len(x) < 2:
        return f"{x.mean():.2f}"
    half = stats.t.ppf(0.975, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x))
    return f"{x.mean():.2f} ± {half:.2f}"


def times(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Time of identification from the short logs, and of its parts on 10,000 random samples."""
    nominal = load_arm("ur10e")
    model = TorqueModel.of_arm(nominal)
    random = random_states(nominal)
    motion = [random[f"random_{k}"] for k in ("q", "dq", "ddq")]
    rows = [
        _row("stacked regressor, 10,000 samples, 6 joints", best(lambda: model.body.regressor(*motion)) * 1e3, "ms", "<= 6"),
        _row("Pinocchio in a loop: stacked regressor, 10,000 samples", best(lambda: _looped(model, *motion), 3) * 1e3, "ms"),
        _row("arrays to base parameters with std", best(lambda: ordinary(model, *motion, random["random_tau"])) * 1e3, "ms", "<= 40"),
    ]  # fmt: skip
    for tool in cases[0]["seconds"]:
        used = [case["seconds"][tool] for case in cases]
        rows.append(
            _row(f"CPU for the shortest log: {tool}", float(np.median(used)), "s", "<= 1" if tool == OURS else "", "median")
        )
    if took := cases[0].get("figaroh"):
        rows += [
            _row("figaroh: stacked regressor, 10,000 samples", took["regressor"] * 1e3, "ms"),
            _row("figaroh: arrays to base parameters", (took["regressor"] + took["base"]) * 1e3, "ms"),
        ]
    return rows


class Case:
    """One arm, one log of it, and two unseen motions."""

    def __init__(self, seed: int, seconds: float) -> None:
        self.seed, self.nominal = seed, load_arm("ur10e")
        truth = without_offsets(varied(self.nominal, 7 + seed))
        # a minute is six motions of 10 s: a single one would be too slow for any tool to identify inertias
        each = [fitting_motion(self.nominal, 3 + seed + 100 * k, MOTION) for k in range(round(seconds / MOTION))]
        motion = reduce(joined, each)
        self.truth, self.motion = truth, motion
        self.log = recorded_on_mock(truth, self.nominal, motion, 1 + seed, timestep=ONE_STEP)
        self.new = [fourier_motion(self.nominal, 40 + 2 * seed + k, 10.0) for k in range(2)]
        self.exact = [predict(truth, motion) for motion in self.new]

    def found(self, predictions: dict[str, list[np.ndarray]], seconds: dict[str, float]) -> dict[str, Any]:
        """Errors of each tool, %, and CPU seconds of each."""
        return {"seconds": seconds, "errors": {tool: self._errors(taus) for tool, taus in predictions.items()}}

    def floors(self) -> dict[str, dict[str, float]]:
        """Smallest average errors, %, that this log allows, by kind of floor and of samples."""
        spread = floors(self.nominal, self.truth, self.motion, self.new)
        return {name: self._errors([t + s for t, s in zip(self.exact, std, strict=True)]) for name, std in spread.items()}

    def _errors(self, taus: list[np.ndarray]) -> dict[str, float]:
        return {kind: _error(taus, self.exact, self.new, kind == "sliding") for kind in ("sliding", "reversals")}


def our_case(case: Case) -> dict[str, Any]:
    """Our errors and those of the ridge on a log."""
    nominal, log, new = case.nominal, case.log, case.new
    m = prepare(log, nominal)
    found, ours = _timed(lambda: identify(nominal, [log]))
    baseline, ridged = _timed(lambda: ridge(nominal, m, new))
    predictions = {
        NOMINAL: [predict(nominal, motion) for motion in new],
        OURS: [predict(found.arm, motion) for motion in new],
        RIDGE: baseline,
    }
    found = case.found(predictions, {OURS: ours, RIDGE: ridged})
    return found | {"errors": found["errors"] | case.floors()}


def peer_case(case: Case) -> dict[str, Any]:
    """The peers' errors on the same log; no errors if they are not installed."""
    out: dict[str, Any] = {"seconds": {}}
    predictions: dict[str, list[np.ndarray]] = {}
    if PYTHON.is_file():
        with tempfile.TemporaryDirectory() as place:
            m = prepare(case.log, case.nominal)
            predictions = peers_on(Path(place), case.nominal, case.log, m, case.new, out, first=case.seed == 0)
    return out | case.found(predictions, out["seconds"])


def _joined(ours: dict[str, Any], peers: dict[str, Any]) -> dict[str, Any]:
    return {**peers, "seconds": ours["seconds"] | peers["seconds"], "errors": ours["errors"] | peers["errors"]}


def _error(taus: list[np.ndarray], exact: list[np.ndarray], motions: list[Trajectory], sliding: bool) -> float:
    """RMS error over joints, % of the standard deviation of each joint's torque, at the sliding samples or at the others."""
    parts = []
    for tau, truth, motion in zip(taus, exact, motions, strict=True):
        fast = np.abs(motion.dq) > SLIDING
        slip = np.stack([slip_direction(q, np.full(len(q), SLIP_WIDTH)) for q in motion.q.T], axis=1)
        turned = slip * np.sign(motion.dq) > TURNED
        parts.append(((tau - truth) / truth.std(axis=0))[fast if sliding else ~fast & turned])
    return 100 * float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    began = time.process_time()
    out = work()
    return out, time.process_time() - began


def best(work: Any, repeats: int = 5) -> float:
    """Smallest CPU time of several runs, s."""
    work()
    out = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        out.append(time.process_time() - began)
    return min(out)


def _looped(model: TorqueModel, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """The same regressor computed sample by sample with Pinocchio."""
    links = model.body.pinocchio
    data, out = links.createData(), np.empty((len(q), model.arm.n, 10 * model.arm.n))
    for k in range(len(q)):
        out[k] = pin.computeJointTorqueRegressor(links, data, q[k], dq[k], ddq[k])
    return out


def _row(what: str, value: float | str, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value if isinstance(value, str) else f"{value:.3g}", "unit": unit, "bar": bar, "note": note}
