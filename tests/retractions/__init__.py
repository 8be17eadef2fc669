"""Facts about retractions, discretization maps and cotangent lifts."""
