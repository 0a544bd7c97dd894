"""Meaning of mode and safety bits: the device's status, and what the operator does about it.

Universal Robots, RTDE Guide: robot_mode, runtime_state, safety_status_bits.
"""

from __future__ import annotations

from collections.abc import Collection

from sim.joint_state import Status

ROBOT_MODES = {
    -1: "no controller", 0: "disconnected", 1: "confirm safety", 2: "booting", 3: "power off", 4: "power on", 5: "idle (brakes on)",
    6: "backdrive", 7: "running", 8: "updating firmware",
}  # fmt: skip
RUNNING = 7
RUNTIME = {0: "stopping", 1: "stopped", 2: "playing", 3: "pausing", 4: "paused", 5: "resuming"}
STOPPED, PLAYING = 1, 2
FULL_SPEED = 0.999
# rules that a cell may waive (sim.assumptions), because a healthy controller might break them
REDUCED, SCALING = "reduced-mode", "speed-scaling"

# bit of safety_status_bits -> status, sentence, remedy; the most severe first
SAFETY = (
    (9, Status.FAULT, "the safety system reports a fault", "restart the controller; if the fault returns, call Universal Robots"),
    (8, Status.FAULT, "a safety limit was violated", "on the pendant, restart the safety system and look up the limit in the log"),
    (7, Status.EMERGENCY_STOP, "an emergency stop is pressed", "clear the cell, turn the button back, switch the robot on again"),
    (6, Status.EMERGENCY_STOP, "the robot's emergency stop is pressed", "clear the cell, turn the button back, switch the robot on"),
    (5, Status.EMERGENCY_STOP, "the system emergency stop is pressed", "clear the cell, release the stop, switch the robot on again"),
    (2, Status.PROTECTIVE_STOP, "the robot is in protective stop", "find what it hit, then press Unlock on the pendant (after 5 s)"),
    (4, Status.PROTECTIVE_STOP, "the safeguard stop is open", "leave the cell, close its guard and reset it on the pendant"),
    (3, Status.PROTECTIVE_STOP, "the robot is in recovery mode", "move it back inside its limits with Freedrive or the Move tab"),
    (10, Status.PROTECTIVE_STOP, "the robot is stopped for safety", "see what the pendant says: an enabling switch, or a safeguard"),
)  # fmt: skip


def safety(bits: int, assumed: Collection[str] = ()) -> tuple[Status, str, str]:
    """Status, sentence and remedy of safety_status_bits."""
    for bit, status, sentence, remedy in SAFETY:
        if bits >> bit & 1:
            return status, sentence, remedy
    if bits >> 1 & 1:
        text = "the robot is in reduced mode: its safety limits are lower than the ones that motions are planned for"
        remedy = f'end what triggers it (an input or a plane in Installation > Safety), or state assume = ["{REDUCED}"] in the cell file'
        return (Status.RUNNING if REDUCED in assumed else Status.IDLE), text, remedy
    if bits & 1:
        return Status.RUNNING, "normal", ""
    return Status.FAULT, f"the safety state is unknown (bits {bits:#x})", "see what the pendant says and restart the controller"


def power(robot_mode: int) -> tuple[Status, str, str]:
    """Status, sentence and remedy of robot_mode."""
    text = f"the robot mode is {ROBOT_MODES.get(robot_mode, str(robot_mode))}"
    if robot_mode == RUNNING:
        return Status.RUNNING, text, ""
    return (
        Status.IDLE,
        text,
        "press the red or yellow button at the bottom left of the pendant, switch on and release the brakes",
    )


def slider(fraction: float) -> tuple[Status, str, str]:
    """Status, sentence and remedy of target_speed_fraction: data recorded below 100 % are of no use."""
    text = f"the speed slider stands at {100 * fraction:.0f} %"
    if fraction >= FULL_SPEED:
        return Status.RUNNING, text, ""
    return Status.IDLE, text, "move the speed slider at the bottom of the pendant to 100 %"


def scaling(speed_scaling: float, assumed: Collection[str] = ()) -> tuple[Status, str, str]:
    """Status, sentence and remedy of speed_scaling. It has meaning only while a program plays: idle controllers may report 0."""
    text = f"the controller scales the speed to {100 * speed_scaling:.0f} %"
    if speed_scaling >= FULL_SPEED or SCALING in assumed:
        return Status.RUNNING, text, ""
    return (
        Status.IDLE,
        text,
        "see on the pendant what limits the speed: the slider, reduced mode, or a safety limit that the motion came near",
    )


def program(runtime_state: int) -> tuple[Status, str, str]:
    """Status, sentence and remedy of runtime_state, while the control program should run."""
    text = f"the control program is {RUNTIME.get(runtime_state, str(runtime_state))}"
    if runtime_state == PLAYING:
        return Status.RUNNING, text, ""
    return (
        Status.IDLE,
        text,
        "it was stopped on the pendant, by another client or by its watchdog: clear that, then connect again",
    )


def other_program(runtime_state: int, name: str = "") -> tuple[Status, str, str]:
    """Status, sentence and remedy of runtime_state before control is taken, which would end any program that is not stopped."""
    if runtime_state == STOPPED:
        return Status.RUNNING, "no program plays", ""
    state = RUNTIME.get(runtime_state, f"in state {runtime_state}")
    return (
        Status.IDLE,
        f"the program {name or '(name not reported)'} is {state} on the controller",
        "taking control would end it, so it was left alone: end it yourself, on the pendant or with the client that started it",
    )


def condition(values: dict[str, tuple[float, ...]], commanded: bool, assumed: Collection[str] = ()) -> tuple[Status, str]:
    """Status and detail of one frame, the safety bits first; `commanded`: our control program should be running."""
    states = [safety(int(values["safety_status_bits"][0]), assumed), power(int(values["robot_mode"][0]))]
    if commanded:
        states.append(program(int(values["runtime_state"][0])))
        states.append(slider(values["target_speed_fraction"][0]))
        states.append(scaling(values["speed_scaling"][0], assumed))
    for status, text, remedy in states:
        if status is not Status.RUNNING:
            return status, f"{text}; {remedy}"
    return Status.RUNNING, ""
