"""Recorded data: recorder, reader, importers."""
