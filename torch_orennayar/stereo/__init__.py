"""Photometric stereo: normals, albedo and roughness from several photographs under known lights.

Where a constant of this folder is "set by hand", no sweep over its value is recorded: the design as a whole was
compared on three objects of DiLiGenT and 36 rendered captures by ``scripts/benchmarks/evaluate_stereo.py``.
"""
