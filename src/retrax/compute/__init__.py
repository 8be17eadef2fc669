"""Evaluation of functions: evaluators, caches of traces and programs, threads, and the binding of the core."""
