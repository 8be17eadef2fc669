"""Tests of the integrators: initial-value steps, trajectories, and the boundary-value solver."""
