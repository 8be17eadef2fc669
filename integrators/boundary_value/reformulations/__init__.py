"""Reformulations of problems: free quantities, switching arcs, horizons that vanish."""
