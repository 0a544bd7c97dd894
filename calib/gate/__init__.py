"""The gate of physics in front of every verdict: are these readings of this arm?"""

from calib.gate.check import Cause, GateCheck
from calib.gate.correction import Correction, applied, parsed
from calib.gate.gate import Gate, gate

__all__ = ["Cause", "Correction", "Gate", "GateCheck", "applied", "gate", "parsed"]
