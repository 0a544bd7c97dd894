"""The measured figures, one module for each part; `python -m benchmarks` prints the table."""

# a figure in CPU seconds means the same on every computer only if one thread did the work
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
