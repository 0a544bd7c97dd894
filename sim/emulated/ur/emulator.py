"""Sockets and time of the emulated controller: one thread that serves its ports and steps the robot at its rate."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

from sim.emulated.promptness import answer_promptly
from sim.emulated.ur import line, robot_api
from sim.emulated.ur.client import Client
from sim.emulated.ur.dashboard import GREETING, respond
from sim.emulated.ur.faults import robot_faults
from sim.emulated.ur.frames import Malformed
from sim.emulated.ur.primary import greeting
from sim.emulated.ur.robot import Robot
from sim.emulated.ur.rtde import RtdeSession
from sim.errors import ConfigError, DeviceError
from sim.resources import nearest

RTDE, DASHBOARD, SCRIPT, SECONDARY = 30004, 29999, 30003, 30002
PRIMARY, PRIMARY_READ_ONLY = 30001, 30011
BEHIND_MAX = 0.5  # s of lost time that is made up for; if more is lost, it does not count


class UrEmulator:
    """The controller at one loopback address.

    `robot` may be read from any thread, and changed through `do`. Time is the wall clock: the robot is stepped once per elapsed
    period, and periods missed on a busy computer are made up for, up to BEHIND_MAX.
    """

    faults = (
        "protective_stop", "emergency_stop", "reduced_mode", "slider_moved", "program_stopped", "program_played", "program_paused",
        "second_client", "local_control", "fieldbus",
        "cable_pulled", "close", "refuse", *line.FAULTS,
    )  # fmt: skip

    def __init__(self, robot: Robot, host: str, robot_api_port: int | None = None) -> None:
        if not host.startswith("127."):
            raise ConfigError(f"host = {host!r}: an emulated controller needs a loopback address, 127.x.y.z; change the cell")
        self.robot, self.host = robot, host
        # PolyScope X has no dashboard server
        own = () if robot.version[0] >= 10 else (DASHBOARD,)
        self._api = robot_api_port if robot.version[0] >= 10 else None
        own = own if self._api is None else (self._api,)
        self.ports = (*own, PRIMARY, SECONDARY, SCRIPT, RTDE, PRIMARY_READ_ONLY)
        self._todo: deque[Callable[[], None]] = deque()
        self._listeners: dict[socket.socket, int] = {}
        self._clients: dict[socket.socket, Client] = {}
        self._selector = selectors.SelectSelector()  # resolves microseconds; epoll only milliseconds
        robot.host = host
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated UR {host}", daemon=True)
        self._cycle, self._due = 0, 0.0  # number of the next cycle, and when it is due, s of the monotonic clock

    def start(self) -> None:
        for port in self.ports:
            listener = socket.socket()
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((self.host, port))
            except OSError as error:
                listener.close()
                self._close_all()
                raise DeviceError(
                    f"{self.host}:{port} cannot be opened ({error.strerror}); is another controller emulated there? "
                    "stop it, or give this cell another address 127.0.0.N"
                ) from error
            listener.listen()
            listener.setblocking(False)
            self._selector.register(listener, selectors.EVENT_READ)
            self._listeners[listener] = port
        self._thread.start()

    def stop(self) -> None:
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()
        self.robot.stop_program()  # also closes the sockets that the program opened
        self._close_all()

    def do(self, action: Callable[[], None]) -> None:
        """Run `action` between two control cycles."""
        self._todo.append(action)

    def inject(self, fault: str) -> None:
        if fault not in self.faults:
            raise ConfigError(f"there is no fault {fault!r}; {nearest(fault, self.faults)}")
        known = {**robot_faults(self.robot), "close": self._close_rtde, "refuse": self._refuse}
        self.do(known.get(fault) or (lambda: self._on_lines(fault)))

    def mend(self) -> None:
        """End the faults of the data lines and plug the cable back in."""

        def action() -> None:
            self.robot.unplugged = False
            self._on_lines(None)

        self.do(action)

    def instructions(self) -> list[str]:
        robot = self.robot
        version = ".".join(str(x) for x in robot.version)
        return [
            f"emulated {robot.model}, PolyScope {version}, {robot.rate:.0f} Hz, at {self.host}: ports "
            + ", ".join(str(p) for p in self.ports),
            "It is on, brakes released, in remote control, without a program. Nobody is in its cell.",
            "Next, in another terminal: calib check, then calib plan, calib record. Ctrl-C here ends it.",
        ]

    def _on_lines(self, fault: str | None) -> None:
        for client in self._clients.values():
            client.line.fault(fault)

    def _close_rtde(self) -> None:
        for client in [c for c in self._clients.values() if c.port == RTDE]:
            self._drop(client)

    def _refuse(self) -> None:
        for listener in list(self._listeners):
            self._selector.unregister(listener)
            listener.close()
        self._listeners.clear()
        for client in list(self._clients.values()):
            self._drop(client)

    def _serve(self) -> None:
        answer_promptly()
        self._due = time.monotonic()
        while not self._ending.is_set():
            wait = max(0.0, self._due - time.monotonic())
            if self.robot.unplugged:
                time.sleep(wait)
            else:
                self._exchange(wait)
            while self._todo:
                self._todo.popleft()()
            now = time.monotonic()
            if now - self._due > BEHIND_MAX:
                self._due = now
            if now >= self._due:
                self._control_cycle()
                self._due += self.robot.dt

    def _exchange(self, wait: float) -> None:
        if not self._listeners and not self._clients:
            time.sleep(wait)
            return
        for key, _ in self._selector.select(wait):
            if not isinstance(key.fileobj, socket.socket):
                continue
            if key.fileobj in self._listeners:
                self._accept(key.fileobj)
            elif key.fileobj in self._clients:
                self._receive(self._clients[key.fileobj])

    def _accept(self, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = Client(connection, self._listeners[listener])
        if client.port == RTDE:
            client.session = RtdeSession(self.robot)
        self._clients[connection] = client
        self._selector.register(connection, selectors.EVENT_READ)
        if client.port == DASHBOARD:
            self._send(client, GREETING.encode() + b"\n")
        if client.port in (PRIMARY, PRIMARY_READ_ONLY) and self.robot.held is not None:
            self._send(client, greeting(self.robot.held, self.robot.model))

    def _receive(self, client: Client) -> None:
        try:
            data = client.socket.recv(65536)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        elif client.session is not None:
            behind = time.monotonic() - self._due
            self.robot.behind = behind if 0.0 < behind <= BEHIND_MAX else 0.0
            try:
                replies = client.session.received(data)
            except Malformed as error:
                self.robot.note(f"an RTDE client was disconnected: {error}")
                self._drop(client)
                return
            for reply in replies:
                self._send(client, reply)
        elif client.port == DASHBOARD:
            *lines, client.text = (client.text + data).split(b"\n")
            for text in lines:
                self._send(client, respond(self.robot, text.decode("utf-8", "replace")).encode() + b"\n")
        elif client.port == self._api:
            *requests, client.text = (client.text + data).split(robot_api.END)
            for request in requests:
                self._send(client, robot_api.answer(self.robot, request))
        elif client.port != PRIMARY_READ_ONLY:
            # a program ends with `end` in the first column
            *programs, client.text = (client.text + data).split(b"\nend\n")
            for program in programs:
                self.robot.upload(program.decode("utf-8", "replace") + "\nend\n")

    def _control_cycle(self) -> None:
        self.robot.step()
        self._cycle += 1
        for client in list(self._clients.values()):
            if client.session is not None:
                data = client.line.carry(client.session.due(self._cycle), self.robot.time)
                if data and not self.robot.unplugged:
                    self._send(client, data)

    def _send(self, client: Client, data: bytes) -> None:
        if not client.send(data):
            self._drop(client)

    def _drop(self, client: Client) -> None:
        if self._clients.pop(client.socket, None) is None:
            return
        self._selector.unregister(client.socket)
        client.socket.close()
        if client.session is not None:
            client.session.closed()

    def _close_all(self) -> None:
        for client in list(self._clients.values()):
            self._drop(client)
        for listener in self._listeners:
            self._selector.unregister(listener)
            listener.close()
        self._listeners.clear()
