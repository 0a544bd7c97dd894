"""Blind cases: arms on which something was hidden by a plant that shares no physics with the product, and the score of `calib diagnose`.

Nothing here imports `sim.plant`, `sim.effects` or `sim.prediction`: the truth must not be made by the code that has to find it.
"""
