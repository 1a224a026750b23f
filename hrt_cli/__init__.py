"""hrt: one UAV survey of a site becomes a ground or underwater robot that can work there."""

__version__ = "0.1.0"
