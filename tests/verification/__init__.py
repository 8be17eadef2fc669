"""Orders, long runs and published optima."""
