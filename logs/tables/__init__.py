"""Tables: CSV, NPZ, MAT and Parquet as named columns of numbers; a column map states what each column means."""

from logs.tables.csv_table import CSV
from logs.tables.matlab_table import MATLAB
from logs.tables.numpy_table import NUMPY
from logs.tables.parquet_table import LEROBOT, PARQUET
from logs.tables.table import Format, Table, read_table

FORMATS: tuple[Format, ...] = (PARQUET, LEROBOT, MATLAB, NUMPY, CSV)

__all__ = ["FORMATS", "Format", "Table", "read_table"]
