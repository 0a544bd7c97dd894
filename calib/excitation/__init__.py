"""Motions that show what an arm is: Fourier excitation, sweeps and probes, and the session plan made of them."""
