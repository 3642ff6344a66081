"""Errors, argument checks, output files, progress and warnings; every folder may import it, and it imports none."""
