"""Identification motions: Fourier excitation, friction sweeps and probes, and the session plan that combines them."""
