"""Rendered training data: pixels, scenes and whole captures with their truth."""
