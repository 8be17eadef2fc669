"""Tests of retrax: each states a mathematical fact."""
