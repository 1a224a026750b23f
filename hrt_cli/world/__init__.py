"""Procedural sample sites."""
