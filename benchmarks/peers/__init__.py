"""Other tools on the same logs: small programs that run in their own environment (`make peers`) and import none of our code."""

from benchmarks.peers.compare import MEASURES, run

__all__ = ["MEASURES", "run"]
