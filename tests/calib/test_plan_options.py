"""Options of `calib plan`: stated values hold, and the others follow from --quick or its absence."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib import main as program
from calib.excitation import session
from calib.excitation.session import Designed, Session
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import AnswerIsNo


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], (2, True, 8)),
        (["--no-probes", "--starts", "3"], (2, False, 3)),
        (["--quick"], (1, False, 0)),
        (["--quick", "--probes", "--starts", "4", "--periods", "3"], (3, True, 4)),
        (["--quick", "--no-probes", "--starts", "0"], (1, False, 0)),
    ],
)
def test_what_is_given_beside_quick_holds(
    given: list[str], expected: tuple[int, bool, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Session] = []

    def no_design(arm: Arm, cell: Cell, requested: Session, *_: object) -> Designed:
        asked.append(requested)
        raise AnswerIsNo("enough of it")

    monkeypatch.setattr(session, "design", no_design)
    assert program.main(["plan", "ur10e", *given, "--out", str(tmp_path / "plan")]) == 1
    assert (asked[0].periods, asked[0].probes, asked[0].starts) == expected


def test_a_plan_for_another_arm_than_the_cells_is_refused_before_it_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main(["plan", "ur5e", "--cell", "mock-ur10e", "--quick", "--out", str(tmp_path / "plan")]) == 2
    assert "has the arm 'ur10e'" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "plan").exists()
