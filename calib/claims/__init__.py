"""A claim is one conclusion: its name, its numbers, and the sentence made from them. Tests check each kind against the written results.

Each entry of SENTENCES is one kind of claim; identify, validate, plan and diagnose state all their conclusions as claims.
"""

from calib.claims.claim import Claim, capital, in_one_sentence
from calib.claims.sentences import SENTENCES

__all__ = ["SENTENCES", "Claim", "capital", "in_one_sentence"]
