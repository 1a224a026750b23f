"""Drive logs of every kind, read as they are: one module per format, and one door."""
