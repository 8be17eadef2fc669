"""Solvers as C programs that need nothing but a C compiler."""
