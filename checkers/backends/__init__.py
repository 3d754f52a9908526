"""One backend a file; `checkers.registry` lists them."""
