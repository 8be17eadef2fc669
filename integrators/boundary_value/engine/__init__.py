"""The engine of the boundary-value solver: Newton's method on blocks of a trajectory, for many trajectories at once."""
