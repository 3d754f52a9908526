"""Compiled scalar formulas and the loops that lift them. The only place in `checkers` that knows numba."""
