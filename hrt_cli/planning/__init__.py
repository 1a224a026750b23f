"""The informative path planner: grid walks, policy, training, refinement, bounds, baselines."""
