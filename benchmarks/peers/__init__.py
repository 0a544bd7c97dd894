"""Other tools on the same logs: small programs that run in an environment of their own (`make peers`), and import nothing of ours."""

from benchmarks.peers.compare import MEASURES, run

__all__ = ["MEASURES", "run"]
