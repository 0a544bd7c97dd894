"""The live view shows joints against their limits, lost frames and the keys that stop; without a terminal it prints lines."""

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from calib.terminal.live import LiveView, Snapshot, show
from safety.run_progress import Cycle, RunProgress
from sim.arm import Arm, load_arm
from sim.joint_state import JointState

KEYS = {"h": "hold", "Ctrl-C": "stop"}


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur10e")


def moment(arm: Arm, **changes: object) -> Snapshot:
    values: dict[str, object] = {
        "motion": "excitation", "stage": "2 of 3", "speed": 0.5, "elapsed": 12.0, "duration": 20.0,
        "q": np.zeros(6), "dq": np.array([0.1, 0, 0, 0, 0, 1.0]) * arm.dq_max, "tau": 0.5 * arm.tau_max,
        "temperature": np.full(6, np.nan), "q_cmd": np.full(6, 0.002), "frames": 6000, "lost": 0, "disk_free": 12e9, "left": 200.0,
    }  # fmt: skip
    return Snapshot(**(values | changes))  # type: ignore[arg-type]


def screen(arm: Arm, snapshot: Snapshot, width: int = 80) -> tuple[str, str]:
    console = Console(file=io.StringIO(), force_terminal=True, width=width, color_system="standard", legacy_windows=False)
    view = LiveView(arm, "record of ur10e", KEYS, following_error_max=0.1, console=console)
    with console.capture() as styled:
        console.print(view.screen(snapshot))
    plain = Console(file=io.StringIO(), width=width)
    with plain.capture() as text:
        plain.print(view.screen(snapshot))
    return text.get(), styled.get()


def test_one_screen_of_eighty_columns_holds_everything(arm: Arm) -> None:
    text, _ = screen(arm, moment(arm))
    assert len(text.splitlines()) == 3 + 1 + arm.n + 2
    for words in (
        "excitation",
        "stage 2 of 3",
        "50% speed",
        "8 s left (run 3.3 min)",
        *arm.joint_names,
        "6000 frames, none lost",
        "12.0 GB free",
    ):
        assert words in text
    assert "h: hold   Ctrl-C: stop" in text
    assert "…" not in text


@pytest.mark.parametrize("width", [60, 76, 80])
def test_a_narrow_terminal_drops_bars_and_no_number(arm: Arm, width: int) -> None:
    s = moment(arm)
    text, _ = screen(arm, s, width)
    for j, joint in enumerate(arm.joint_names):
        (line,) = (line for line in text.splitlines() if line.startswith(joint))
        assert f"{s.q[j]:+.2f}" in line
        assert f"{s.tau[j]:+.1f}" in line
        assert f"{abs(s.dq[j]) / arm.dq_max[j]:.0%}" in line
        assert line.split()[-1] == f"{1000 * abs(s.q[j] - s.q_cmd[j]):.1f}"
    assert "…" not in text.split("6000 frames")[0]
    assert ("─" in text) is (width > 76)


def test_the_narrowest_terminal_shortens_the_names_and_no_number(arm: Arm) -> None:
    s = moment(arm)
    text, _ = screen(arm, s, 42)
    lines = [line for line in text.splitlines() if line.endswith(tuple(f"{1000 * abs(e):.1f}" for e in s.q - s.q_cmd))]
    assert len(lines) == arm.n
    assert all(f"{q:+.2f}" in line for line, q in zip(lines, s.q, strict=True))


@pytest.mark.parametrize("value", [0.11, -0.2])
def test_what_is_beyond_a_limit_is_red(arm: Arm, value: float) -> None:
    q_cmd = np.full(6, 0.002)
    q_cmd[2] = value
    _, styled = screen(arm, moment(arm, q_cmd=q_cmd, dq=np.zeros(6)))
    assert ["\x1b[1;31m" in line for line in styled.splitlines() if "_joint" in line] == [
        False,
        False,
        True,
        False,
        False,
        False,
    ]


def test_what_is_not_reported_is_a_dash_and_not_a_zero(arm: Arm) -> None:
    text, _ = screen(arm, moment(arm, q_cmd=np.full(6, np.nan), tau=np.full(6, np.nan)))
    for line in text.splitlines():
        if "_joint" in line:
            assert line.split()[-3:] == ["–", "–", "–"]


def test_lost_frames_are_red(arm: Arm) -> None:
    assert "\x1b[1;31m3 lost" in screen(arm, moment(arm, lost=3))[1]


def test_away_from_a_terminal_it_is_a_line_every_few_seconds(arm: Arm) -> None:
    out, clock = io.StringIO(), iter(np.arange(0, 60, 0.5))
    with LiveView(arm, "record", KEYS, console=Console(file=out, width=400), now=lambda: float(next(clock))) as view:
        for _ in range(22):
            view.update(moment(arm, note="speed raised"))
    lines = out.getvalue().splitlines()
    assert lines[0] == "record; h: hold   Ctrl-C: stop"
    assert len(lines) == 1 + 3
    assert lines[1] == (
        "excitation (stage 2 of 3, 50% speed) 12.0 of 20.0 s, speed up to 100% (wrist_3_joint), torque up to 50% "
        "(shoulder_pan_joint), following error 2.0 mrad (shoulder_pan_joint), 6000 frames, 0 lost; speed raised"
    )


def test_a_run_is_shown_from_its_proof_to_its_motion(arm: Arm, tmp_path: Path) -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80, legacy_windows=False)
    still = np.zeros(arm.n)
    state = JointState(0.0, 0.0, still, still, still, still, still)
    cycle = Cycle(499, 1000, state, still)
    with LiveView(arm, "record", KEYS, console=console, now=iter(range(100)).__next__) as view:
        show(view, RunProgress("verifying friction", 0.5, None), tmp_path)
        proof = out.getvalue()
        assert "verifying friction" in proof
        assert "Nothing moves yet." in proof
        show(view, RunProgress("friction at 25%", 0.5, cycle, 2, 4, 0.25, 10.0, 45.0, 500, 2), tmp_path)
    moving = out.getvalue()[len(proof) :]
    for words in ("friction at 25%", "stage 2 of 4", "25% speed", "5 s left (run 45 s)", "500 frames", "2 lost", "GB free"):
        assert words in moving
