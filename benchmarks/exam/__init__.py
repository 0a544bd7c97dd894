"""Blind cases for `calib diagnose` and their score: a plant that shares no physics with the product hides something in an arm.

No recording is made with `sim.plant`, `sim.effects` or `sim.prediction`: the truth must not come from the code that has to find
it. Only `true_model`, which writes the true arm for the comparison after an answer, uses the catalogue.
"""
