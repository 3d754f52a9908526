"""Readers of recorded traffic, a file for each kind; `predictor.recordings.open_data` picks one.

Each module has `open_files(name, files, on_bad)`, which gives a data set, and `read(path)`, which gives the
recordings of one file and raises `InputError` naming it if it cannot.
"""
