"""Vehicles, the local planners that steer them, and the simulator of a drive."""
