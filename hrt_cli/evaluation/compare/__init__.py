"""Two artifacts of one kind, and how they differ."""
