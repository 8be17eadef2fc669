"""Audits of solutions: qualification, smoothness, second-order conditions, errors, termination status."""
