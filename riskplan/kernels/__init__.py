"""Compiled parts of planning: motion of the car, Dubins curves, static world, charging of risk."""
