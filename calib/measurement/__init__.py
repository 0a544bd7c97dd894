"""Recordings as samples that may be used: read, resampled on the device clock, filtered without phase, what stands and what is missing marked."""
