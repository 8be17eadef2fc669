"""Inputs of a solver: boundary data, guesses and options, read and checked once."""
