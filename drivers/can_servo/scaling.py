"""Physical values as the unsigned integers of a frame, by the rule of the DBC files: raw = round((x - offset) / factor)."""

from __future__ import annotations

from sim.errors import DeviceError


class Field:
    """raw = round((x - low) / factor), factor = (high - low) / (2^bits - 1); x in [low, high], ties to even.

    Vendor code truncates instead, which shifts every value by half a step on average; cantools rounds like this.
    A value outside the range is a DeviceError and never clamped: the drive would not do what was commanded.
    """

    __slots__ = ("factor", "high", "low", "name", "top", "unit")

    def __init__(self, name: str, low: float, high: float, bits: int, unit: str) -> None:
        if not low < high:
            raise DeviceError(
                f"{name}: range {low} to {high} {unit} is empty; read the drive's range again or correct the cell file"
            )
        self.name, self.unit = name, unit
        self.low, self.high = low, high
        self.top = (1 << bits) - 1
        self.factor = (high - low) / self.top

    def raw(self, x: float) -> int:
        """The integer for x; DeviceError unless low <= x <= high, so NaN is refused too."""
        if not self.low <= x <= self.high:
            raise DeviceError(
                f"{self.name} {x:.6g} {self.unit} cannot be sent: the drive's frame carries {self.low:g} to {self.high:g} {self.unit}; "
                "plan within that range, or widen the range on the drive with its maker's tool"
            )
        return round((x - self.low) / self.factor)

    def value(self, raw: int) -> float:
        """The physical value of an integer."""
        return raw * self.factor + self.low
