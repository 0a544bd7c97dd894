"""From recordings to samples: resampled on the device clock, filtered with zero phase, unusable ones marked."""
