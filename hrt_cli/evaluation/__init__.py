"""Metrics of each artifact."""
