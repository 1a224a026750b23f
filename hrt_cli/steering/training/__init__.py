"""How the network learns from recordings."""
