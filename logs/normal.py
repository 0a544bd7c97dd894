"""Numbers of the normal distribution."""

INTERVAL = 1.96  # standard deviations on each side of the mean that hold 95 % of it
OF_MEDIAN = 1.4826  # standard deviation over the median absolute deviation
