"""Drivability per class and the scoremap on the robot's grid."""
