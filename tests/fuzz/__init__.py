"""Malformed inputs for every importer and the command line; `python -m tests.fuzz` runs a campaign."""
