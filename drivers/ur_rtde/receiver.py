"""RTDE frames: each exactly once, in order, with its arrival time on the host; an old one is never returned as new."""

from __future__ import annotations

import math
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.emulated_address import START, at_emulator
from drivers.ur_rtde.wire import BrokenStream, Recipe, Splitter, request
from sim.errors import DeviceError

PORT = 30004
REMEDY = (
    "see that the robot is on and its network cable is in, that [options] host is the address shown in Settings > System > Network, and "
    "that RTDE is enabled in Settings > Security > Services"
)
CONNECT_TIMEOUT = 3.0  # s for each answer during the handshake
LAG_WINDOW = 10.0  # s over which the smallest transport delay is kept; 200 ppm of clock drift are 2 ms in that time
REPEATS_MAX = 3
CLOCK_MAX = 2.0**31  # s since the controller started, as far as a recording's stamps reach
KEPT_MAX = (
    10_000  # frames that wait for a reader; beyond it the oldest are dropped, which by then are too old to be read anyway
)

REQUIRED = (
    "timestamp", "actual_q", "actual_qd", "actual_current", "joint_temperatures", "robot_mode", "runtime_state",
    "robot_status_bits", "safety_status_bits", "speed_scaling", "target_speed_fraction",
)  # fmt: skip
OPTIONAL = ("actual_current_as_torque", "payload", "payload_cog", "target_gravity", "tcp_offset")


@dataclass(frozen=True, slots=True)
class Frame:
    """One data frame: t host monotonic s at reception, age s at t (transport delay beyond the smallest), values by name."""

    t: float
    age: float
    values: dict[str, tuple[float, ...]]

    @property
    def t_device(self) -> float:
        """Controller time, s."""
        return self.values["timestamp"][0]


@dataclass
class LinkCount:
    """Counts of frames: kept, lost (missing time stamps), and received again."""

    frames: int = 0
    lost: int = 0
    repeated: int = 0


class Receiver:
    """An RTDE client that only listens. After `connect`, a thread takes frames off the socket until `close`.

    A failure (closed socket, broken stream, time going backwards, a frozen clock, or anything else that ends the thread) is kept and
    raised by every later `next`.
    `tap(from_device, frame)` gets every frame in both directions, except text messages of the controller.
    """

    def __init__(self, host: str, tap: Callable[[bool, bytes], None] = lambda from_device, frame: None) -> None:
        self.host, self._tap = host, tap
        self.version = (0, 0, 0, 0)
        self.rate = 0.0
        self.count = LinkCount()
        self._frames: deque[Frame] = deque(maxlen=KEPT_MAX)
        self._arrived = threading.Condition()
        self._failure: str | None = None
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._closing = False
        self._last: float | None = None
        self._row = 0
        self._lags = [math.inf, math.inf]
        self._window_end = -math.inf

    def connect(self) -> None:
        """Do the handshake and start the thread; DeviceError with the remedy within a bounded time."""
        try:
            self._socket = socket.create_connection((self.host, PORT), timeout=CONNECT_TIMEOUT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._splitter = Splitter()
            self._pending: Iterator[tuple[str, bytes]] = iter(())
            self._handshake()
        except (OSError, UnicodeError) as error:  # a host name may be impossible
            self.close()
            remedy = START if at_emulator(self.host) else REMEDY
            raise DeviceError(f"no RTDE at {self.host}:{PORT} ({error}); {remedy}") from error
        except BrokenStream as error:
            self.close()
            raise DeviceError(f"{self.host}:{PORT} does not speak RTDE as expected: {error}; is it a UR controller?") from error
        self._thread = threading.Thread(target=self._receive, name=f"RTDE {self.host}", daemon=True)
        self._thread.start()

    def next(self, deadline: float) -> Frame | None:
        """The next frame; None if none has arrived by `deadline` (host monotonic s); DeviceError after a failure."""
        with self._arrived:
            while not self._frames:
                if self._failure is not None:
                    raise DeviceError(f"{self.host}: {self._failure}")
                wait = deadline - time.monotonic()
                if wait <= 0 or not self._arrived.wait(wait):
                    if self._frames:
                        break
                    return None
            return self._frames.popleft()

    @property
    def waiting(self) -> int:
        """Number of frames that wait."""
        return len(self._frames)

    def close(self) -> None:
        """Close the socket and end the thread."""
        self._closing = True
        if self._socket is not None:
            try:
                self._socket.shutdown(socket.SHUT_RDWR)
            except OSError:
                # the controller closed the connection first
                self._failure = self._failure or "the connection is closed"
            self._socket.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=2.0)

    def _handshake(self) -> None:
        if self._ask("V", struct.pack(">H", 2)) != b"\x01":
            raise BrokenStream("protocol version 2 was refused")
        version = self._ask("v")
        if len(version) != 16:
            raise BrokenStream(f"a controller version has 16 bytes, {len(version)} came")
        self.version = struct.unpack(">4I", version)
        self.rate = 125.0 if self.version[0] == 3 else 500.0
        names = [*REQUIRED, *OPTIONAL]
        recipe, types = self._outputs(names)
        missing = [name for name, type_ in zip(names, types, strict=True) if type_ == "NOT_FOUND"]
        if set(missing) & set(REQUIRED):
            lacking = ", ".join(sorted(set(missing) & set(REQUIRED)))
            raise BrokenStream(f"PolyScope {self.version[0]}.{self.version[1]} does not send {lacking}; update PolyScope")
        if missing:
            names = [name for name in names if name not in missing]
            recipe, types = self._outputs(names)
        self._recipe = Recipe(recipe, tuple(names), types)
        if self._ask("S") != b"\x01":
            raise BrokenStream("the controller did not start sending")

    def _outputs(self, names: list[str]) -> tuple[int, tuple[str, ...]]:
        answer = self._ask("O", struct.pack(">d", self.rate) + ",".join(names).encode())
        types = tuple(answer[1:].decode("ascii", "replace").split(","))
        if not answer or len(types) != len(names):
            raise BrokenStream(f"{len(names)} variables were requested, {len(types)} types came")
        return answer[0], types

    def _ask(self, kind: str, payload: bytes = b"") -> bytes:
        connection = self._socket
        assert connection is not None
        connection.sendall(request(kind, payload))
        self._tap(False, request(kind, payload))
        end = time.monotonic() + CONNECT_TIMEOUT
        while True:
            for received, content in self._pending:
                if received == kind:
                    self._tap(True, request(received, content))
                    return content
                if received != "M":  # text messages may come at any time
                    raise BrokenStream(f"a frame {received!r} came as the answer to {kind!r}")
            if time.monotonic() > end:
                raise TimeoutError(f"no answer to {kind!r}")
            data = connection.recv(65536)
            if not data:
                raise ConnectionResetError("the controller closed the connection")
            self._pending = iter(self._splitter.feed(data))

    def _receive(self) -> None:
        assert self._socket is not None
        failure = "the controller closed the RTDE connection; see that it is on and its cable is in, then connect again"
        try:
            # frames that came together with the last answer of the handshake
            self._take(list(self._pending), time.monotonic())
            self._socket.settimeout(None)
            while data := self._socket.recv(65536):
                self._take(self._splitter.feed(data), time.monotonic())
        except OSError as error:
            failure = f"the RTDE connection broke ({error}); see that the controller is on and its cable is in"
        except BrokenStream as error:
            failure = f"{error}; the connection is no longer used: look for a second program that uses it, then connect again"
        except Exception as error:  # no thread may end without a reason: a reader would wait and never learn why
            failure = (
                f"a frame could not be processed ({type(error).__name__}: {error}); connect again, and report it if it recurs"
            )
        with self._arrived:
            self._failure = "the connection is closed" if self._closing else failure
            self._arrived.notify_all()

    def _take(self, frames: list[tuple[str, bytes]], now: float) -> None:
        kept = []
        for kind, payload in frames:
            if kind == "U":
                self._tap(True, request(kind, payload))
                values = self._recipe.unpack(payload)
                if self._in_order(values):
                    kept.append(Frame(now, self._age(values["timestamp"][0], now), values))
            elif kind != "M":
                raise BrokenStream(f"a frame of kind {kind!r} came among data frames")
        if kept:
            self.count.frames += len(kept)
            with self._arrived:
                self._frames.extend(kept)
                self._arrived.notify_all()

    def _in_order(self, values: dict[str, tuple[float, ...]]) -> bool:
        """Whether this frame is a new one; counts missing frames; BrokenStream if its time cannot be trusted."""
        for name, numbers in values.items():
            if not all(map(math.isfinite, numbers)):
                raise BrokenStream(f"{name} = {numbers} is not finite")
        t = values["timestamp"][0]
        if not 0 <= t < CLOCK_MAX:
            raise BrokenStream(
                f"timestamp = {t:.10g} s cannot be the time since the controller started (rule: 0 to {CLOCK_MAX:.0f} s)"
            )
        if self._last is None:
            self._last = t
            return True
        if t == self._last:
            self._row += 1
            self.count.repeated += 1
            if self._row > REPEATS_MAX:
                raise BrokenStream(f"the controller's clock stands still at {t:.3f} s")
            return False
        if t < self._last:
            raise BrokenStream(f"the controller's clock went back from {self._last:.10g} s to {t:.10g} s")
        self.count.lost += max(0, round((t - self._last) * self.rate) - 1)
        self._last, self._row = t, 0
        return True

    def _age(self, t_device: float, now: float) -> float:
        """Transport delay beyond the smallest within LAG_WINDOW, s; a constant part of the delay cannot be observed."""
        lag = now - t_device
        if now > self._window_end:
            self._lags, self._window_end = [self._lags[1], math.inf], now + LAG_WINDOW
        self._lags[1] = min(self._lags[1], lag)
        return lag - min(self._lags)
