"""Tests of the doors to pymanopt and geomstats."""
