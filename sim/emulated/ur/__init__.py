"""An emulated Universal Robots controller: RTDE 30004, dashboard 29999, script 30003, secondary 30002, primary 30001 and 30011, Robot API.

What is modelled from documents and from the source of ur_rtde 1.6.5, and was never compared with a real controller: how long a
program takes to start, the filter behind servoj, the deceleration of a protective stop, what a paused program reports. No source says
what speed_scaling is while no program plays: IDLE_SPEED_SCALING of `robot` is the value that a client must not trip over.
"""
