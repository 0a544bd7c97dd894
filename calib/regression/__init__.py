"""Least squares shared by identification and diagnosis: square-root information, row noise, friction laws."""
