"""Shape from shading: depth and normals from one photograph."""
