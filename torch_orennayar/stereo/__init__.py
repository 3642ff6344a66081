"""Photometric stereo: normals, albedo and roughness from several photographs under known lights."""
