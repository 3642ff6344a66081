"""Mutated files for every reader, as the best file libraries are tested."""
