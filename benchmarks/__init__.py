"""The measured figures, one module for each part; `python -m benchmarks` prints the table."""
