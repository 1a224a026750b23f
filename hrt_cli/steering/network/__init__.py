"""The network that steers: its layers, its loss, the file it lies in, and what it answers."""
