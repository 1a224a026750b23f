"""The local planner that sees: a network from the forward camera to discretised steering."""
