"""The test for the convergence of Newton's method on a small system, in loops of JAX and of tapes."""

MAX_JACOBIANS = 15  # Jacobians of one solve: an iteration that needs more counts as one that does not converge
QUADRATIC_POWER = 0.65  # of eps: a step, in the unknowns' sizes, from which on one that hardly shrinks is rounding
SMALLEST_PART = 0.25  # of eps: the unknowns are known where so much of their sizes remains
# Unknowns are moved by so many of their roundings, and steps of so many of the changes that follow are rounding.
PROBE = 8.0
