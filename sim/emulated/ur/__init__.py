"""An emulated Universal Robots controller: RTDE 30004, dashboard 29999, script 30003 and secondary 30002, on loopback.

What is modelled from documents and from the source of ur_rtde 1.6.5, and was never compared with a real controller: how long a
program takes to start, the filter behind servoj, the deceleration of a protective stop, what a paused program reports.
"""
