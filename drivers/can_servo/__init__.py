"""Servo arms on a CAN bus: frames, bring-up, streaming, faults. The layout of every frame is in configs/can/*.dbc."""
