"""Watching an arm while it works: payload, contact, wear and validity of the model, followed from what the drives report."""
