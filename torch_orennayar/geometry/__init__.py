"""Cameras, meshes, depth maps, integration of normals, error metrics and simple shapes."""
