"""What identification and diagnosis share of least squares: information in square-root form, the noise of rows, friction laws."""
