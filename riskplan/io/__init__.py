"""Scenes and results from and to files."""
