"""Emulated Universal Robots controller: RTDE 30004, dashboard 29999, script 30003, secondary 30002, primary 30001 and 30011, Robot API.

Modelled from documents and from the source of ur_rtde 1.6.5, never compared with a real controller: the time that a program
takes to start, the filter behind servoj, the deceleration of a protective stop, and what a paused program reports. No source
states speed_scaling while no program plays: IDLE_SPEED_SCALING of `robot` is a value that a client must tolerate.
"""
