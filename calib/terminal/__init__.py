"""The terminal: messages, tables, numbers, the live view and the stop key."""
