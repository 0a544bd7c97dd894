"""Servo arms on a CAN bus: frames, bring-up, streaming, faults. The layout of every frame stands in configs/can/*.dbc."""
