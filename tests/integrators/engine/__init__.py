"""Tests of the linear algebra of trajectories, against dense solves."""
