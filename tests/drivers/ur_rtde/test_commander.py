"""The loop of the command process, with a control interface that only records calls."""

from __future__ import annotations

import itertools
import socket
import threading
from collections.abc import Iterator

import pytest

from drivers.ur_rtde.commander import NUMBER, SETPOINT, Commander, Lost

SETTINGS = {
    "period": 0.002, "lookahead": 0.03, "gain": 300.0, "stop_deceleration": 10.0, "setpoint_timeout": 30.0, "watchdog": 10.0, "ahead": 0.0,
}  # fmt: skip


class Remembers:
    def __init__(self) -> None:
        self.targets: list[list[float]] = []
        self.stopped = 0
        self.kicks = 0
        self.takes = True

    def servoJ(self, q: list[float], *_: float) -> bool:
        self.targets.append(q)
        return self.takes

    def servoStop(self, _: float) -> bool:
        self.stopped += 1
        return self.takes

    def kickWatchdog(self) -> bool:
        self.kicks += 1
        return self.takes


def setpoint(number: int, q: float, dq: float = 0.0) -> bytes:
    return b"Q" + SETPOINT.pack(number, *[q] * 6, *[dq] * 6)


@pytest.fixture
def channel() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(10.0)
    with ours, theirs:
        yield ours, theirs


def test_setpoints_that_come_together_are_all_sent_in_their_order(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    control = Remembers()
    for k in range(5):
        ours.send(setpoint(k, 0.1 * k))
    thread = threading.Thread(target=Commander(control, theirs, SETTINGS).run)
    thread.start()
    taken = [NUMBER.unpack(ours.recv(64)[1:])[0] for _ in range(5)]
    ours.shutdown(socket.SHUT_RDWR)
    thread.join(10.0)
    assert taken == [0, 1, 2, 3, 4]
    assert [q[0] for q in control.targets[:5]] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4]), "no jump to the newest"


def test_more_setpoints_than_may_be_late_end_the_motion(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    for k in range(20):
        ours.send(setpoint(k, 0.0, 0.1))
    with pytest.raises(Lost, match="40 ms late"):
        Commander(Remembers(), theirs, {**SETTINGS, "setpoint_timeout": 0.03}).run()


def test_a_stop_comes_before_the_setpoints_that_wait(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    control = Remembers()
    for k in range(5):
        ours.send(setpoint(k, 0.1 * k))
    ours.send(b"S")
    thread = threading.Thread(target=Commander(control, theirs, SETTINGS).run)
    thread.start()
    assert ours.recv(64) == b"S"
    ours.shutdown(socket.SHUT_RDWR)
    thread.join(10.0)
    assert not any(q[0] > 0.05 for q in control.targets)


def test_the_stop_brings_every_joint_to_rest_within_its_deceleration(channel: tuple[socket.socket, socket.socket]) -> None:
    control = Remembers()
    commander = Commander(control, channel[1], SETTINGS)
    commander.follow(b"Q" + SETPOINT.pack(1, *[0.0] * 6, 1.0, -0.5, 0.0, 0.0, 0.0, 0.0))
    commander.rest()
    path = control.targets
    speed = [(b[0] - a[0]) / 0.002 for a, b in itertools.pairwise(path)]
    assert max(speed) <= 1.0
    assert max(a - b for a, b in itertools.pairwise(speed)) <= 10.0 * 0.002 + 1e-9
    assert path[-1][0] == pytest.approx(1.0 / (2 * 10.0), rel=1e-6), "v^2 / 2a"
    assert path[-1][1] == pytest.approx(-(0.5**2) / (2 * 10.0), rel=1e-6)
    assert path[-1] == path[-2]
    assert control.stopped == 1


def test_a_closed_channel_is_the_order_to_stop(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    control = Remembers()
    ours.send(setpoint(1, 0.0, 0.2))
    ours.shutdown(socket.SHUT_RDWR)
    Commander(control, theirs, SETTINGS).run()
    assert control.targets == [], "an order is obeyed before a setpoint that came with it"


def test_without_setpoints_the_arm_is_stopped_and_the_supervisor_notified(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    control = Remembers()
    commander = Commander(control, theirs, {**SETTINGS, "setpoint_timeout": 0.02})
    thread = threading.Thread(target=commander.run)
    thread.start()
    ours.send(setpoint(7, 0.0, 0.1))
    assert ours.recv(64)[:1] == b"A"
    assert ours.recv(64) == b"T"
    assert control.targets[-1][0] == pytest.approx(0.1**2 / (2 * 10.0), rel=1e-6)
    ours.shutdown(socket.SHUT_RDWR)
    thread.join(10.0)
    assert not thread.is_alive()
    assert control.stopped == 1


def test_between_motions_the_watchdog_is_fed_until_that_fails(channel: tuple[socket.socket, socket.socket]) -> None:
    control = Remembers()

    def kick() -> bool:
        control.kicks += 1
        return control.kicks < 3

    control.kickWatchdog = kick  # type: ignore[method-assign]
    with pytest.raises(Lost, match="kickWatchdog"):
        Commander(control, channel[1], SETTINGS).run()
    assert control.kicks == 3


def test_a_setpoint_that_is_not_taken_ends_the_process(channel: tuple[socket.socket, socket.socket]) -> None:
    control = Remembers()
    control.takes = False
    channel[0].send(setpoint(1, 0.0))
    with pytest.raises(Lost, match="servoJ"):
        Commander(control, channel[1], SETTINGS).run()


def test_between_setpoints_the_last_one_is_held_and_the_watchdog_fed(channel: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = channel
    control = Remembers()

    def servo(q: list[float], *_: float) -> bool:
        control.targets.append(q)
        if len(control.targets) == 4:
            ours.shutdown(socket.SHUT_RDWR)
        return True

    control.servoJ = servo  # type: ignore[method-assign]
    ours.send(setpoint(1, 0.25))
    Commander(control, theirs, SETTINGS).run()
    assert control.targets[:4] == [[0.25] * 6] * 4
