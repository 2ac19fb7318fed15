"""Made by `make generated` from templates/; not written by hand."""
