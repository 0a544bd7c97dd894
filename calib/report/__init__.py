"""The pages of the results: one style, one file each, readable offline, in print and in dark mode, and accessible."""
