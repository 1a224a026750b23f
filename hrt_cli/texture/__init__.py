"""Texture classes: Gabor bank, colour, patch statistics, K-means, the texture model."""
