"""One module per mission format that autopilots open."""
