"""Every sentence of identify, validate and plan is a claim with numbers, and each kind is checked against the written files."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.claims import SENTENCES, Claim
from calib.excitation import session
from calib.identification.base_fit import Options
from calib.identification.calibrated import write_calibrated
from calib.identification.claims import CHANGED, KEPT
from calib.identification.identify import Identification, identify
from calib.identification.model import TorqueModel
from calib.identification.outcome import parameter_table
from calib.main import main
from calib.terminal.quantity import rounded, significant
from calib.validation.validate import INFORMATIVE, forward_claims, validate
from calib.verdict import GOOD_SHARE
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from tests.calib.conftest import fourier_motion, recorded, varied
from tests.calib.test_discriminate import ELBOW, SPRING, diagnosis


def fits(seed: int) -> tuple[Arm, Identification]:
    """An arm chosen by seed, with too little motion to show all of it, and its identification."""
    nominal = load_arm(("ur5e", "servo6", "ur3e")[seed % 3])
    truth = varied(nominal, seed)
    if seed % 2:
        truth = with_effect(truth, ArmEffect("viscous_friction", truth.joint_names[seed % 6], {"viscous": 0.0}))
        truth = with_effect(truth, ArmEffect("coulomb_friction", truth.joint_names[(seed + 2) % 6], {"coulomb": 0.0}))
    logs = [recorded(truth, fourier_motion(nominal, 10 * seed + k, seconds=8.0), seed + k) for k in (1, 2)]
    return nominal, identify(nominal, logs[:1], logs[1:] if seed % 3 else [], Options(robust=bool(seed % 2)))


@pytest.mark.parametrize("seed", [1, 2, 3, pytest.param(4, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)])
def test_what_identify_claims_is_so_in_what_it_wrote(seed: int, tmp_path: Path) -> None:
    nominal, found = fits(seed)
    written = TorqueModel.of_arm(write_calibrated(tmp_path / "arm", nominal, found.arm)).nominal()
    table = json.loads(json.dumps(found.result.as_dict()))
    parameters = {e["name"]: e for e in table["estimates"]}
    now = dict(zip(parameters, written, strict=True))
    file = dict(zip(parameters, TorqueModel.of_arm(nominal).nominal(), strict=True))
    claims = {c["claim"]: c for c in table["claims"]}
    assert len(claims) == len(table["claims"])
    for name, e in parameters.items():
        assert e["written"] == pytest.approx(now[name], rel=1e-6, abs=1e-9)
        if e["lower"] is not None:
            assert now[name] >= e["lower"] - 1e-12
    known = {name for name, e in parameters.items() if e["identifiable"]}
    assert set(claims["identified"]["names"]) == known
    assert claims["identified"]["of"] == len(parameters)
    kept, moved = (set(claims.get(key, {"names": []})["names"]) for key in ("kept", "moved"))
    assert kept | moved == set(parameters) - known
    assert not kept & moved
    away = {name: abs(now[name] - file[name]) / parameters[name]["prior_std"] for name in kept | moved}
    assert all(away[name] <= KEPT * 1.001 for name in kept)
    assert all(away[name] > KEPT * 0.999 for name in moved)
    if moved:
        assert away[claims["moved"]["farthest"]] == pytest.approx(max(away[name] for name in moved), rel=1e-3)
        assert claims["moved"]["most"] == pytest.approx(max(away[name] for name in moved), rel=1e-3)
    outside = {name for name, e in parameters.items() if e["lower"] is not None and e["value"] < e["lower"]}
    assert {r["name"] for r in claims.get("out_of_bounds", {"parameters": []})["parameters"]} == outside
    changed = {name for name, e in parameters.items() if abs(now[name] - e["value"]) > CHANGED * e["std"]} - outside
    assert {r["name"] for r in claims.get("projected", {"parameters": []})["parameters"]} == changed
    _residual(table, claims["residual"], "holdout" if found.holdout else "training")
    gap = table["holdout"] or table["training"]
    worse = {j for j, b, a in zip(table["joint_names"], gap["before"], gap["after"], strict=True) if a > 1.02 * b}
    assert {r["joint"] for r in claims.get("worse", {"joints": []})["joints"]} == worse
    assert claims["condition"]["condition"] == table["condition"]
    text = "; ".join([table["outcome"], *table["findings"]])
    assert [c["sentence"] for c in table["claims"] if c["sentence"] not in text] == []
    _no_impossible_estimate(found, outside)


def _residual(table: dict[str, Any], claim: dict[str, Any], which: str) -> None:
    gap = table[which]
    left = np.array(gap["sliding"]) / np.array(gap["signal"])
    rows = table["joint_verdicts"]
    assert [r["left"] for r in rows] == pytest.approx(left.tolist())
    assert {r["joint"] for r in rows if r["verdict"] != "good"} == {r["joint"] for r in rows if r["left"] > r["limit"]}
    assert set(claim["beyond"]) == {r["joint"] for r in rows if r["left"] > r["limit"]}
    worst = max(rows, key=lambda r: r["left"] / r["limit"])
    assert claim["worst"] == worst["joint"]
    assert claim["sentence"].startswith(claim["verdict"])
    assert f"{worst['left']:.1%}" in claim["sentence"]
    assert (claim["verdict"] == "good") == (not claim["beyond"])


def _no_impossible_estimate(found: Identification, outside: set[str]) -> None:
    _, rows = parameter_table(found.result)
    kinds = ("Ia", "viscous", "coulomb", "offset")
    for j, row in enumerate(rows):
        for kind, cell in zip(kinds, row[1:], strict=True):
            e = found.result.estimate(f"{kind}_{j + 1}")
            if e.name in outside:
                assert "±" not in cell
                assert f"{e.value:.4g}" not in cell
            else:
                assert cell.startswith(rounded(e.value, e.std))


def test_which_reading_was_used_is_claimed_and_written(tmp_path: Path) -> None:
    """With a coarse encoder the written arm uses the speed reading, and the claim states the cutoff of the fit."""
    nominal = load_arm("ur5e")
    log = recorded(varied(nominal, 6), fourier_motion(nominal, 60, seconds=8.0), 1)
    coarse = replace(log, q=np.round(log.q / 4e-3) * 4e-3, q_cmd=np.full(log.q.shape, np.nan))
    for given, stated in ((log, None), (coarse, None), (coarse, 12.0)):
        found = identify(nominal, [given], options=Options(cutoff=stated))
        table = json.loads(json.dumps(found.result.as_dict()))
        claims = {c["claim"]: c for c in table["claims"]}
        folder = tmp_path / f"{stated}{given is coarse}"
        assert write_calibrated(folder, nominal, found.arm).speed_from == (
            "measured" if "speed_reading" in claims else "position"
        )
        assert ("speed_reading" in claims) == (given is coarse)
        settings = table["settings"]
        assert ("cutoff" in claims) == (stated is None and settings["cutoff_hz"] < settings["motion_hz"])
        assert stated is None or settings["cutoff_hz"] == stated
        if "cutoff" in claims:
            assert (claims["cutoff"]["cutoff_hz"], claims["cutoff"]["motion_hz"]) == (
                settings["cutoff_hz"],
                settings["motion_hz"],
            )
        assert all(c["sentence"] in "; ".join([table["outcome"], *table["findings"]]) for c in table["claims"])


def test_an_estimate_that_no_arm_has_is_not_printed(tmp_path: Path) -> None:
    """For a joint without friction, noise puts the estimate below zero as often as above."""
    _, found = fits(1)
    result = found.result
    below = replace(result.estimate("viscous_2"), value=-1.0, std=0.2)
    estimates = tuple(below if e.name == "viscous_2" else e for e in result.estimates)
    _, rows = parameter_table(replace(result, estimates=estimates))
    assert rows[1][2].startswith("physically impossible, written ")
    maybe = replace(below, std=1.0)
    _, rows = parameter_table(replace(result, estimates=tuple(maybe if e is below else e for e in estimates)))
    assert rows[1][2].startswith("below 0.96, written ")


@pytest.mark.parametrize("factor", [1.0, 1.15, 1.6])
def test_what_validate_claims_is_so(factor: float, ur5e: Arm) -> None:
    truth = varied(ur5e, 3)
    logs = [recorded(truth, fourier_motion(ur5e, k, seconds=6.0), k) for k in (1, 2)]
    subject = replace(ur5e, tree=replace(ur5e.tree, mass=ur5e.tree.mass * factor))
    found = validate(subject, logs)
    table = json.loads(json.dumps(found.as_dict()))
    claims = {c["claim"]: c for c in table["claims"]}
    rows = table["joint_verdicts"]
    assert set(claims["residual"]["beyond"]) == {r["joint"] for r in rows if r["left"] > r["limit"]}
    assert all(r["limit"] >= GOOD_SHARE for r in rows)
    for k, row in enumerate(rows):
        of = [[(e[v][k], e[n][k]) for e in table["logs"]] for v, n in (("residual_sliding", "rows_sliding"), ("signal", "rows"))]  # fmt: skip
        residual, signal = (np.sqrt(sum(n * x**2 for x, n in each) / sum(n for _, n in each)) for each in of)
        assert row["left"] == pytest.approx(residual / signal)
    forward = [
        (entry["log"], joint, *(entry["forward"][key][k] for key in ("rms", "travel", "bound")))
        for entry in table["logs"]
        for k, joint in enumerate(table["joints"])
    ]
    worst = max(forward, key=lambda r: r[2])
    assert claims["forward"]["joint"] == worst[1]
    assert claims["forward"]["off_deg"] == pytest.approx(np.degrees(worst[2]))
    bounds = claims["bounds"]
    beyond = {joint for _, joint, off, _, bound in forward if off > bound}
    vague = {joint for _, joint, _, travel, bound in forward if bound > INFORMATIVE * travel}
    assert {r["joint"] for r in bounds["beyond"]} == beyond
    assert set(bounds["not_informative"]) == vague - beyond
    assert set(bounds["within"]) == set(table["joints"]) - vague - beyond
    for joint in bounds["not_informative"][:4]:
        assert joint in bounds["sentence"].split("not informative at ")[1]
    assert ("within the stated bound at every joint" in bounds["sentence"]) == (not beyond and not vague)
    assert table["outcome"] == "; ".join(c["sentence"] for c in table["claims"])


def test_an_unstable_simulation_is_no_error_in_degrees(ur5e: Arm) -> None:
    """A light joint with friction: validate reports an unstable simulation, and validation.json stays valid JSON."""
    log = recorded(varied(ur5e, 3), fourier_motion(ur5e, 1, seconds=6.0), 1)
    found = validate(ur5e, [log])
    check = found.checks[0]
    endless = np.full(ur5e.n, np.inf)
    broken = replace(check, motion=(replace(check.motion[0], angle=endless, flange=np.inf), *check.motion[1:]))
    claims = {c.name: c for c in forward_claims(ur5e, [check, replace(broken, log="other.mcap")])}
    assert claims["unstable"].numbers["logs"] == ["other.mcap"]
    assert {r["log"] for r in claims["bounds"].numbers["rows"]} == {check.log}
    claims = {c.name: c for c in forward_claims(ur5e, [broken])}
    assert set(claims) == {"unstable"}
    assert "unstable in" in claims["unstable"].sentence
    assert "inf" not in claims["unstable"].sentence
    table = json.dumps(replace(found, checks=(broken,), claims=tuple(claims.values())).as_dict(), allow_nan=False)
    assert "unstable" in table


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(231.4, 2, "230"), (0.05461, 3, "0.0546"), (4869.0, 3, "4870"), (12.0, 2, "12"), (-345.0, 1, "-300")],
)
def test_a_rounded_number_is_written_out(value: float, digits: int, text: str) -> None:
    assert significant(value, digits) == text


def test_what_plan_claims_is_so(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Includes the motion that separates two explanations of a diagnosis. Motions are fewer and shorter than with `--quick`."""
    monkeypatch.setattr(session, "QUICK", replace(session.QUICK, tries=5, speeds=(0.2,), chirp=3.0))
    monkeypatch.setattr(session, "discriminating", partial(session.discriminating, iterations=2))
    folder = tmp_path / "plan"
    rivals = diagnosis(tmp_path / "run", SPRING, ("torque_offset", ELBOW))
    line = f"plan ur5e --quick --period 8 --home 0,-1.4,1.3,-1.4,-1.2,0.3 --discriminate {rivals} --out {folder} --json"
    assert main(line.split()) == 0
    table = json.loads(capsys.readouterr().out)
    claims = {c["claim"]: c for c in table["claims"]}
    motions = [np.load(file) for file in sorted(folder.glob("*.npy"))]
    assert len(motions) == len(table["motions"])
    assert claims["duration"]["seconds"] == pytest.approx(sum(m["duration"] for m in table["motions"]))
    assert set(claims["known"]["names"]) == set(table["identifiable"])
    assert claims["known"]["of"] == len(table["identifiable"]) + len(table["not_identifiable"])
    assert "discriminate" in [m["name"] for m in table["motions"]]
    assert claims["separation"]["sigma"] == table["separation_sigma"] > claims["separation"]["enough"] == 5.0
    assert table["outcome"] == "; ".join(c["sentence"] for c in table["claims"])
    assert table["next"] == f"calib record CELL {folder}"


def test_every_kind_of_claim_has_a_sentence_and_no_other_has() -> None:
    assert Claim("separation", {"sigma": 3.0, "enough": 5.0}).sentence.count("less than the 5") == 1
    assert "less than" not in Claim("separation", {"sigma": 6.0, "enough": 5.0}).sentence
    assert "higher than with the nominal" in Claim("worse", {"joints": [{"joint": "a", "before": 1.0, "after": 2.0}]}).sentence
    with pytest.raises(KeyError):
        _ = Claim("hope", {}).sentence
    assert {"residual", "identified", "kept", "moved", "projected", "out_of_bounds", "forward", "bounds"} <= set(SENTENCES)


def test_a_poor_fit_says_what_nobody_stated_of_its_drives() -> None:
    stated = load_arm("ur5e")
    silent = replace(stated, prior=stated.prior.model_copy(update={"unknown": ["rotor"]}))
    logs = [recorded(stated, fourier_motion(stated, 7, seconds=8.0), 1)]
    strict = Options(max_error=1e-4)
    found = {c.name: c for c in identify(silent, logs, options=strict).result.claims}
    beyond = found["residual"].numbers["beyond"]
    assert found["unstated_drives"].numbers["joints"] == {joint: ["reflected inertia"] for joint in beyond}
    assert "state them (`calib arm new --drive`)" in found["unstated_drives"].sentence
    assert "unstated_drives" not in {c.name for c in identify(stated, logs, options=strict).result.claims}
    assert "unstated_drives" not in {c.name for c in identify(silent, logs).result.claims}
