"""A row's advice can be followed, and the fleet is then assessed. `calib fleet` itself has no `--assume`."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from calib import main as program
from calib.fleet.inventory import by_arm, inventory
from calib.fleet.job import Answer, ArmStatus, Job
from calib.fleet.task import work
from calib.gate.commands import by_import
from sim.arm import Arm
from tests.calib.conftest import fourier_motion, recorded
from tests.calib.fleet.conftest import write_words


def answer(folder: Path, arm: Arm) -> Answer:
    ((arm_id, own),) = by_arm(inventory(str(folder))[0]).items()
    return work(Job(arm_id, arm, own, diagnose=False))


@pytest.mark.slow
def test_a_row_advises_what_can_be_done(tmp_path: Path, ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, 12.0, 125.0), 1)
    tau = log.tau.copy()
    tau[:, 1] *= -1
    file = write_words(tmp_path / "the plant" / "a.mcap", ur5e, replace(log, tau=tau), "excitation", 0.0)
    found = answer(file.parent, ur5e)
    assert found.status is ArmStatus.BAD_LOGS
    sentence = found.row["sentence"]
    begin = f"calib import '{file}' --arm ur5e --assume"
    assert (
        f"convert it with `{begin} sign:tau:shoulder_lift_joint`. To use it unchanged: `{begin} as-recorded`; then replace"
        in sentence
    )
    assert sentence.count("--assume") == sentence.count("calib import")
    command = shlex.split(sentence.split("`")[1])
    assert program.main([*command[1:], "--out", str(tmp_path / "imported")]) == 0
    (tmp_path / "imported" / "a.mcap").replace(file)
    assert answer(file.parent, ur5e).status is not ArmStatus.BAD_LOGS


def test_several_words_stay_one_command() -> None:
    text = "convert it with --assume scale:tau:elbow=1.5 --assume swap:all:a,b. To use it unchanged: --assume as-recorded"
    advice = by_import(text, "ur5e")
    assert "with `calib import LOG --arm ur5e --assume scale:tau:elbow=1.5 --assume swap:all:a,b`. To" in advice
    assert by_import(advice, "ur5e") == advice
    assert by_import("a.mcap: damaged", "ur5e") == "a.mcap: damaged"
