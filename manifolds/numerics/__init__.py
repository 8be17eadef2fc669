"""Numerical tools that every layer shares: ambient vector arithmetic, root finding, stable series, errors."""
