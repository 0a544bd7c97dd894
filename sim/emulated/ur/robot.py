"""The controller itself: modes, safety, registers and one program in front of a plant, stepped one control cycle at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from sim.emulated.ur.functions import Functions
from sim.emulated.ur.motion import Motion
from sim.emulated.ur.primary import HeldArm
from sim.emulated.ur.program import control_program, register_offset
from sim.emulated.ur.urscript import Ended, NotCompiled, Program
from sim.joint_state import JointState
from sim.tree import GRAVITY

STOPPED, PLAYING, PAUSED = 1, 2, 4  # runtime_state
POWER_OFF, RUNNING = 3, 7  # robot_mode
NORMAL, REDUCED, PROTECTIVE_STOP, EMERGENCY_STOP = 1, 2, 3, 7  # safety_mode
JOINT_RUNNING, JOINT_OFF = 253, 235  # joint_mode
PROGRAM_START = 0.06  # s from upload to the first cycle of a program
UNLOCK_AFTER = 5.0  # s during which a protective stop cannot be unlocked
STOP_DECELERATION = 20.0  # rad/s^2 of a protective or emergency stop
PROGRAM_END_DECELERATION = 4.0  # rad/s^2 when a program ends in motion
AMBIENT = 27.0  # degC, if the plant has no temperature
# speed_scaling while no program plays. The RTDE guide calls it the scaling of the trajectory limiter, and there is no trajectory
# then. No source states what is reported, so this is a value that a client must tolerate
IDLE_SPEED_SCALING = 0.0
CURRENT_PER_TORQUE = 0.1  # A/(N m), if no torque constant is given; similar to a UR10e's


class JointPlant(Protocol):
    """The part of `sim.plant.Plant` that the controller needs."""

    def reset(self, q: np.ndarray) -> None: ...
    def command(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> None: ...
    def advance(self, dt: float) -> None: ...
    def read(self) -> JointState: ...


class Robot:
    """State of the emulated controller; it changes in `step` and in calls between two steps, in one thread."""

    def __init__(
        self,
        plant: JointPlant,
        q: np.ndarray,
        version: tuple[int, int, int] = (5, 25, 1),
        model: str = "UR10",
        serial: str = "20230000000",
        torque_constant: np.ndarray | None = None,
        gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY),
        payload: tuple[float, tuple[float, float, float]] = (0.0, (0.0, 0.0, 0.0)),
    ) -> None:
        self.version, self.build, self.model, self.serial = version, 0, model, serial
        self.rate = 125.0 if version[0] == 3 else 500.0
        self.dt = 1.0 / self.rate
        self.time = 0.0
        self.behind = 0.0  # s that are still to be made up for after a pause of the computer
        self.remote = True
        self.robot_mode, self.safety_mode, self.runtime_state = RUNNING, NORMAL, STOPPED
        self.speed_slider, self.idle_speed_scaling = 1.0, IDLE_SPEED_SCALING
        self.operational_mode = "AUTOMATIC"
        self.program_name = ""
        self.held: HeldArm | None = None
        self.ended: list[str] = []  # programs of others that an upload ended
        self.payload, self.payload_cog = payload[0], list(payload[1])
        # set_gravity of URScript takes the acceleration away from the earth's centre; the value read back is assumed to match
        self.target_gravity = [-g for g in gravity]
        self.tcp_offset = [0.0] * 6
        self.input_int, self.input_double = [0] * 48, [0.0] * 48
        self.output_int, self.output_double = [0] * 48, [0.0] * 48
        self.claims: dict[str, object] = {}
        self.notes: deque[str] = deque(maxlen=100)
        self.background: Iterator[None] | None = None
        self.motion = Motion(q, self.dt)
        self._plant, self._constant = plant, torque_constant
        self._program: Iterator[None] | None = None
        self._starting: tuple[float, Callable[[], Iterator[None]]] | None = None
        self._functions: Functions | None = None
        self.host, self.unplugged = "127.0.0.1", False
        self._watch: tuple[str, float] | None = None
        self._written: dict[str, float] = {}
        self._stopped_at = -np.inf
        plant.reset(np.array(q, dtype=float))
        self._sense()

    def step(self) -> None:
        """One control cycle: program, target, plant, sensors."""
        self.time += self.dt
        if self._starting is not None and self.time >= self._starting[0]:
            self._program, self._starting = self._starting[1](), None
            self.runtime_state = PLAYING
        if self._watch is not None and self.time - self._written.get(self._watch[0], self.time) > self._watch[1]:
            self.note(f"watchdog: {self._watch[0]} was not written for {self._watch[1]:.3f} s; the program stops")
            self.stop_program()
        if self.runtime_state == PLAYING:
            self._run()
        self.motion.step()
        self._plant.command(self.motion.q, self.motion.dq, np.zeros_like(self.motion.q))
        self._plant.advance(self.dt)
        self._sense()

    def _run(self) -> None:
        for routine in (self.background, self._program):
            if routine is not None and self.runtime_state == PLAYING:
                try:
                    next(routine)
                except (StopIteration, Ended) as end:
                    if isinstance(end, Ended):
                        self.note(str(end))
                    if routine is self.background:
                        self.background = None
                    else:
                        self.stop_program()

    def _sense(self) -> None:
        state = self._plant.read()
        self.actual_q, self.actual_qd, self.actual_torque = state.q.tolist(), state.dq.tolist(), state.tau.tolist()
        current = state.current
        if not np.all(np.isfinite(current)):
            current = state.tau * (CURRENT_PER_TORQUE if self._constant is None else 1.0 / self._constant)
        self.actual_current = current.tolist()
        self.joint_temperatures = np.where(np.isfinite(state.temperature), state.temperature, AMBIENT).tolist()
        self.target_q, self.target_qd, self.target_qdd = (
            self.motion.q.tolist(),
            self.motion.dq.tolist(),
            self.motion.ddq.tolist(),
        )

    def write_input(self, name: str, value: float) -> None:
        """Take an input variable that arrived over RTDE. The watchdog counts from its arrival, also while steps are made up for."""
        self._written[name] = self.time + self.behind
        if name.startswith("input_int_register_"):
            self.input_int[int(name.rsplit("_", 1)[1])] = int(value)
        elif name.startswith("input_double_register_"):
            self.input_double[int(name.rsplit("_", 1)[1])] = value
        elif name == "speed_slider_fraction":
            self.speed_slider = min(1.0, max(0.0, value))

    def upload(self, text: str) -> None:
        """Take a program from a script port; if the robot is ready and in remote control, it replaces the running one."""
        if (
            self.robot_mode != RUNNING
            or self.safety_mode not in (NORMAL, REDUCED)
            or (self.version[0] in (5, 10) and not self.remote)
        ):
            self.note("a program arrived while the robot was not ready or in local control; it was not started")
            return
        if self.program_name:
            self.note(f"an upload ended the program {self.program_name}")
            self.ended.append(self.program_name)
        self.stop_program()
        offset = register_offset(text)
        if offset is not None:
            self._starting = (self.time + PROGRAM_START, lambda: control_program(self, offset))
            return
        functions = Functions(self)
        try:
            program = Program(text, functions.table())
        except NotCompiled as error:
            self.note(f"a program arrived that is neither ur_rtde's control program nor understood: {error}; it ends at once")
            return
        self._functions = functions
        self._starting = (self.time + PROGRAM_START, program.run)

    def watch(self, name: str, frequency: float) -> None:
        """rtde_set_watchdog(name, frequency, "stop")."""
        self._watch = (name, 1.0 / frequency) if frequency > 0 else None
        self._written[name] = self.time

    def stop_program(self) -> None:
        """End the program; the arm comes to rest."""
        self._program = self.background = self._starting = self._watch = None
        if self._functions is not None:
            self._functions.close()
            self._functions = None
        self.program_name = ""
        if self.runtime_state != STOPPED:
            self.runtime_state = STOPPED
            self.motion.stop(PROGRAM_END_DECELERATION)

    def play(self, name: str, paused: bool = False) -> None:
        """Play a program of the operator or another client; the arm stands still until the program is ended."""
        self.stop_program()
        self.program_name, self._program, self.runtime_state = name, _waits(), PAUSED if paused else PLAYING

    def reduce(self) -> None:
        """Enter reduced mode, as on its trigger; motion continues."""
        self.safety_mode = REDUCED

    def protective_stop(self) -> None:
        """Stop at once and pause the program; `unlock` ends the stop."""
        self.safety_mode, self._stopped_at = PROTECTIVE_STOP, self.time
        if self.runtime_state == PLAYING:
            self.runtime_state = PAUSED
        self._watch = None
        self.motion.stop(STOP_DECELERATION)

    def unlock(self) -> bool:
        """Unlock a protective stop; return False if there is none or within 5 s of it. The program stays paused."""
        if self.safety_mode != PROTECTIVE_STOP or self.time - self._stopped_at < UNLOCK_AFTER:
            return False
        self.safety_mode = NORMAL
        return True

    def emergency_stop(self) -> None:
        """Stop at once, end the program and switch the drives off."""
        self.safety_mode = EMERGENCY_STOP
        self.stop_program()
        self.motion.stop(STOP_DECELERATION)
        self.robot_mode = POWER_OFF

    def note(self, sentence: str) -> None:
        """Record what would appear in the controller's log."""
        self.notes.append(f"{self.time:.3f} s: {sentence}")

    @property
    def program_running(self) -> bool:
        return self.runtime_state == PLAYING

    @property
    def robot_status_bits(self) -> int:
        return (self.robot_mode == RUNNING) | self.program_running << 1 | 1 << 3

    @property
    def safety_status_bits(self) -> int:
        bits = {NORMAL: 1 << 0, REDUCED: 1 << 1, PROTECTIVE_STOP: 1 << 2 | 1 << 10, EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10}
        return bits[self.safety_mode]

    @property
    def speed_scaling(self) -> float:
        return self.speed_slider if self.program_running else self.idle_speed_scaling

    @property
    def joint_mode(self) -> list[int]:
        return [JOINT_RUNNING if self.robot_mode == RUNNING else JOINT_OFF] * len(self.actual_q)


def _waits() -> Iterator[None]:
    while True:
        yield
