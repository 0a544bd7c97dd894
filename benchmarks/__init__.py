"""Measured figures, one module per topic; `python -m benchmarks` prints them as a table."""

# CPU seconds are comparable between computers only if a single thread did the work
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
