"""Figures a person looks at."""
