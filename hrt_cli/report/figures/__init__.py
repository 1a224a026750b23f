"""Pictures: one module per thing that is drawn."""
