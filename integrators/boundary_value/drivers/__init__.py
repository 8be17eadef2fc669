"""Drivers, each of many solves: guesses, continuation, meshes, phases."""
