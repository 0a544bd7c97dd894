"""Universal Robots over RTDE: frames by our own client, commands by ur_rtde in a supervised process.

ur_rtde's receive interface keeps only the newest of the frames that arrive together (measured: a sixth of them lost at 500 Hz on a
busy computer). It returns old values after its socket is gone, and cannot request `actual_current_as_torque`. So `receiver` reads the
frames itself. ur_rtde's control interface can hang, crash, or upload its program again unasked. So `commander` runs it in a process
that is killed and replaced, never reconnected. The controller's own watchdog stops the arm when that process is gone. If the cell sets
`ahead`, that process sends setpoints ahead to a program of our own instead (`ahead`).
"""
