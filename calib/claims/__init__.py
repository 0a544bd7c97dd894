"""A conclusion is a claim: its name, its numbers, and the sentence made of them. Tests check each kind of claim against what was written.

One entry of SENTENCES is one kind of claim; identify, validate, plan and diagnose state their conclusions in no other way.
"""

from calib.claims.claim import Claim, capital, in_one_sentence
from calib.claims.sentences import SENTENCES

__all__ = ["SENTENCES", "Claim", "capital", "in_one_sentence"]
