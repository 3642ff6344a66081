"""Errors, argument checks, files and progress: what every other folder may use, and which uses none of them."""
