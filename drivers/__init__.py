"""How to talk to an arm: driver interface, mock, ur_rtde, can_servo, replay."""
